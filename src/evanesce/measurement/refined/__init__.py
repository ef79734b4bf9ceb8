"""The refined area estimator: edge position, light, blur, plate, subsurface scattering, saturation."""
