"""What is published of the silicones, each figure with its place in the thesis and a caution where it needs one."""

from evanesce.materials.tables import Material, material, material_names

__all__ = ["Material", "material", "material_names"]
