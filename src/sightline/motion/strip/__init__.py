"""The joint estimate of a strip's motion."""
