"""Published values and constitutive laws of the silicones; each value with its source in the thesis, and a caution."""

from evanesce.materials.tables import Material, material, material_names, silicone_of

__all__ = ["Material", "material", "material_names", "silicone_of"]
