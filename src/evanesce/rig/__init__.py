"""The rig as data: plate, LEDs, finger, camera, loading programme. Strict, frozen, no physics."""

from evanesce.rig.camera import Camera, Distortion
from evanesce.rig.card import Cards
from evanesce.rig.environment import Environment
from evanesce.rig.finger import Contact, Finger, Fingerprint, Ridges, ScannedSkin
from evanesce.rig.height_map import copy_height_map
from evanesce.rig.leds import LedCircuit, Leds
from evanesce.rig.liquid import Liquid
from evanesce.rig.load import dump_scene, load_scene, scene_path
from evanesce.rig.plate import Plate
from evanesce.rig.programme import Press, Ramp, Slide
from evanesce.rig.scene import Scene
from evanesce.rig.spectrum_file import copy_scene_files
from evanesce.rig.surroundings import Backdrop, Haze, Spill, Surroundings

__all__ = [
    "Backdrop",
    "Camera",
    "Cards",
    "Contact",
    "Distortion",
    "Environment",
    "Finger",
    "Fingerprint",
    "Haze",
    "LedCircuit",
    "Leds",
    "Liquid",
    "Plate",
    "Press",
    "Ramp",
    "Ridges",
    "ScannedSkin",
    "Scene",
    "Slide",
    "Spill",
    "Surroundings",
    "copy_height_map",
    "copy_scene_files",
    "dump_scene",
    "load_scene",
    "scene_path",
]
