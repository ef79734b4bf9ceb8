"""The refined estimator beside the reference segmentation."""
