"""The thesis's published segmentation and area, step by step."""
