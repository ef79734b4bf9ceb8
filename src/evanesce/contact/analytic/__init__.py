"""Contact laws in closed form: Hertz, JKR, Xydas and Kao, partial slip, roughness, viscoelastic spheres."""
