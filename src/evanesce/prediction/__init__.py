"""A bundle's frames as views, and predictions of these views for any values of the rig's parameters."""
