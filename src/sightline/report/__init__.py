"""Results as figures and one self-contained HTML page."""
