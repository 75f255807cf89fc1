"""Least squares over a block of images: poses, points, what is common."""
