"""Images and cameras to images that people use."""
