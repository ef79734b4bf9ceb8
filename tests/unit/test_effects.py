"""Every effect of the folder: declared fully, absent bit for bit at null, and acting as its formula says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import evanesce.effects
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.resources import resource
from evanesce.core.states import ContactState, Frame, PlateGrid, PlateLight, SensorLight
from evanesce.effects import OBSERVABLES, Active, Context, Effect, Stage, active_effects, all_effects, apply_stage
from evanesce.effects.inference_hints import LOG10, ROOT, SQUARE
from evanesce.optics.projection import Projection
from evanesce.rig import Scene, dump_scene, load_scene
from evanesce.rig.camera import Distortion
from evanesce.sensor.lens import form_image

SHAPE = (47, 61)


def scene(**effects: dict[str, object]) -> Scene:
    return load_scene("thesis").model_copy(update={"effects": effects})


def context(**effects: dict[str, object]) -> Context:
    return Context(scene(**effects), seed=5, time_s=0.1, index=3)


def ridged() -> Scene:
    return load_scene("thesis_ridged")


def value_of(stage: Stage, name: str = "") -> object:
    """An ugly value of each stage; of an effect that asks for more, such as ridges, by its name."""
    numbers = np.random.default_rng(2).uniform(0.3, 900.0, SHAPE)
    match stage:
        case Stage.PLATE_LIGHT:
            return PlateLight(radiance=numbers, variance=numbers**2, focal_px=77.7, principal_point=(21.3, 30.1))
        case Stage.SENSOR_LIGHT:
            return SensorLight(irradiance=numbers)
        case Stage.CHARGE:
            return numbers
        case Stage.READOUT:
            return 4.3 * numbers  # up to near full well
        case Stage.FRAME:
            return Frame(data=numbers.astype(np.uint8), raw=numbers.astype(np.uint16), time=0.7)
        case Stage.CONTACT:
            return ContactState(
                grid=PlateGrid(SHAPE, 0.1, (1.0, -2.0)),
                pressure=numbers,
                gap=numbers / 7,
                contact_mask=np.clip(numbers / 500, 0, 1),
                normal_force=1.3,
                nominal_contact_area=12.3,
                law="none",
            )
        case Stage.RIG:
            return ridged() if name == "ridge_height" else load_scene("thesis_slide") if name == "friction" else scene()
        case Stage.LOAD:
            return 1.3


def bytes_of(value: object) -> list[bytes]:
    """All that a value holds, to the bit."""
    if isinstance(value, Scene):
        return [dump_scene(value).encode()]
    if isinstance(value, np.ndarray):
        return [value.tobytes()]
    if isinstance(value, float):
        return [value.hex().encode()]
    return [
        entry.tobytes() if isinstance(entry, np.ndarray) else repr(entry).encode() for entry in vars(value).values()
    ]


@pytest.fixture(params=sorted(all_effects()))
def effect(request: pytest.FixtureRequest) -> Effect:
    return all_effects()[request.param]


def strong(effect: Effect) -> Strict:
    """Parameters with every amplitude well off its null."""
    amplitudes = {name: q.bounds[1] / 3 for name, q in effect.parameters.quantities() if name in effect.amplitudes}
    return effect.parameters(**amplitudes)


# --- the contract of each effect -------------------------------------------------------------------------------------


def test_every_file_of_the_folder_is_found() -> None:
    folder = Path(next(iter(evanesce.effects.__path__)))
    files = {p.stem for p in folder.glob("*/*.py")} - {"__init__"}
    assert set(all_effects()) == files
    assert {"vignetting", "ambient_light", "black_level", "hot_pixels"} <= files


def test_parameters_declare_unit_bounds_and_null(effect: Effect) -> None:
    declared = dict(effect.parameters.quantities())
    assert set(declared) == set(effect.parameters.model_fields), "every parameter is declared by quantities.field"
    for name, quantity in declared.items():
        assert quantity.unit, name
        assert quantity.doc, name
    assert effect.is_null(effect.parameters()), "an empty table leaves the effect out"
    assert not effect.is_null(strong(effect))


def test_absent_bit_for_bit_at_null(effect: Effect) -> None:
    """Skipped at null, and the identity when applied all the same, whichever amplitude is the one at null."""
    value = value_of(effect.stage, effect.id)
    nulls = {name: dict(effect.parameters.quantities())[name].null for name in effect.amplitudes}
    for gone in [nulls] if effect.null_when == "all" else [{name: null} for name, null in nulls.items()]:
        parameters = strong(effect).model_copy(update=gone)
        assert effect.is_null(parameters)
        skipped = apply_stage(effect.stage, value, (Active(effect, parameters),), context())
        assert skipped is value
        applied = effect.apply(value, parameters, context())
        assert bytes_of(applied) == bytes_of(value)


def test_pure_and_repeatable(effect: Effect) -> None:
    value = value_of(effect.stage, effect.id)
    before = bytes_of(value)
    first = bytes_of(effect.apply(value, strong(effect), context()))
    assert bytes_of(effect.apply(value, strong(effect), context())) == first
    assert bytes_of(value) == before
    assert first != before


def test_each_has_a_validation_page(effect: Effect) -> None:
    page = resource("docs", "validation", f"effect-{effect.id}.md")
    if not page.parent.is_dir():
        pytest.skip("the documentation is not installed beside the package")
    text = page.read_text(encoding="utf-8")
    for heading in ("Reference", "Provenance", "Model", "Criterion", "Result"):
        assert f"**{heading}.**" in text


def test_an_effect_without_an_off_is_refused() -> None:
    class NoNull(Strict):
        size: float = field(1.0, unit="1", bounds=(0.0, 2.0))

    with pytest.raises(TypeError, match="null"):
        Effect(id="x", stage=Stage.FRAME, parameters=NoNull, amplitudes=("size",), apply=lambda v, p, c: v)
    with pytest.raises(TypeError, match="no amplitude"):
        Effect(id="x", stage=Stage.FRAME, parameters=NoNull, amplitudes=(), apply=lambda v, p, c: v)


# --- what a fit may vary -------------------------------------------------------------------------------------------


def test_declares_what_a_fit_may_vary(effect: Effect) -> None:
    """Names, departures and starts agree with the parameters; the effect departs from null where they say."""
    candidates = effect.candidate_parameters()
    nulls, default = dict(effect.parameters.quantities()), effect.parameters()
    off = {name for name in effect.amplitudes if getattr(default, name) == nulls[name].null}
    # What multiplies a list is fitted where data showed the places.
    off -= {effect.marks.scale} if effect.marks else set()
    assert {c.name.split("[")[0] for c in candidates} >= off, "every amplitude that is off can be fitted"
    assert set(effect.needs) <= set(OBSERVABLES)
    assert effect.needs
    assert effect.is_null(effect.with_values({c.name: c.null for c in candidates}))
    for candidate in candidates:
        low, high = candidate.bounds
        assert low <= candidate.null <= high
        inside = min(max(candidate.null + candidate.deviation, low), high)
        if inside == candidate.null:
            inside = max(candidate.null - candidate.deviation, low)
        assert inside != candidate.null
        stepped = effect.with_values({candidate.name: inside})
        assert stepped != effect.parameters(), "one step changes what it names"
        for value in candidate.start:
            effect.with_values({candidate.name: value})
    if effect.null_when == "any" and len(off) > 1:
        started = effect.with_values({c.name: c.start[0] for c in candidates if c.start})
        assert not effect.is_null(started), "amplitudes that multiply have no derivative at null: start elsewhere"


class Pair(Strict):
    """Two amplitudes of unlike bounds, a pair of numbers and a count."""

    a_um: float = field(0.5, unit="um", bounds=(-1.0, 3.0), null=0.5)
    b_deg: float = field(0.0, unit="deg", bounds=(0.0, 7.0), null=0.0)
    place_mm: tuple[float, float] = field((1.5, -2.0), unit="mm", bounds=(-9.0, 9.0))
    first: int = field(2, unit="1", bounds=(0, 11))


def pair(**more: object) -> Effect:
    values = {"id": "pair", "stage": Stage.FRAME, "parameters": Pair, "amplitudes": ("a_um", "b_deg"), **more}
    return Effect(apply=lambda v, p, c: v, **values)  # type: ignore[arg-type]


def test_departures_default_to_a_tenth_of_the_bounds_and_start_at_null() -> None:
    first, second = pair().candidate_parameters()
    assert (first.name, first.unit, first.null, first.bounds) == ("a_um", "um", 0.5, (-1.0, 3.0))
    assert first.deviation == pytest.approx(0.4)
    assert second.deviation == pytest.approx(0.7)
    assert first.amplitude
    assert first.start == ()
    assert pair().needs == ("press",)


def test_one_number_of_a_pair_and_counts_can_be_fitted() -> None:
    effect = pair(fitted={"b_deg": 2.0, "place_mm[1]": 0.3, "first": 4.0}, start={"first": (0.0, 5.0), "b_deg": 1.5})
    angle, place, count = effect.candidate_parameters()
    assert (place.null, place.amplitude) == (-2.0, False)
    assert (count.null, count.start) == (2.0, (0.0, 5.0))
    assert angle.start == (1.5,)
    made = effect.with_values({"place_mm[1]": 0.25, "first": 4.6, "b_deg": 3.0})
    assert made.model_dump() == {"a_um": 0.5, "b_deg": 3.0, "place_mm": (1.5, 0.25), "first": 5}
    with pytest.raises(InputError, match="b_deg"):
        effect.with_values({"b_deg": 7.5})


def test_a_departure_is_as_plausible_in_its_coordinate() -> None:
    (angle,) = pair(fitted={"b_deg": 2.0}, coordinates={"b_deg": ROOT}).candidate_parameters()
    assert angle.spread == pytest.approx(2.0**0.5)
    assert angle.away(1.0) == pytest.approx(2.0)
    assert angle.away(0.5) == pytest.approx(0.5)
    assert angle.away(-1.0) == 0.0
    assert angle.away(9.0) == pytest.approx(7.0)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"coordinates": {"first": ROOT}}, "not fitted"),
        ({"coordinates": {"a_um": LOG10}}, "no coordinate of a_um"),
        ({"fitted": {"place_mm[0]": 1.0}, "coordinates": {"place_mm[0]": SQUARE}}, "no coordinate of place_mm"),
        ({"fitted": {"c": 1.0}}, "no parameter c"),
        ({"fitted": {"place_mm": 1.0}}, "not one number"),
        ({"fitted": {"place_mm[2]": 1.0}}, "not one number"),
        ({"fitted": {"a_um[0]": 1.0}}, "not one number"),
        ({"fitted": {"a_um": 0.0}}, "departure"),
        ({"fitted": {"a_um": float("nan")}}, "departure"),
        ({"fitted": {"a_um": 4.5}}, "departure"),
        ({"start": {"b_deg": 8.0}}, "bounds 0 to 7"),
        ({"start": {"first": 1.0}}, "not fitted"),
        ({"needs": ("press", "a hammer")}, "a hammer"),
    ],
)
def test_wrong_declarations_are_refused(more: dict[str, object], words: str) -> None:
    with pytest.raises(TypeError, match=words):
        pair(**more)


def test_amplitudes_that_add_are_absent_only_together() -> None:
    one_off = {"a_um": 0.5, "b_deg": 1.0}
    assert pair().is_null(Pair(**one_off))
    assert not pair(null_when="all").is_null(Pair(**one_off))
    assert pair(null_when="all").is_null(Pair())


# --- what a scene may say --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"vigneting": {"k": 0.1}}, ["effects.vigneting", "nearest: vignetting"]),
        ({"vignetting": {"kk": 0.1}}, ["effects.vignetting.kk", "nearest key: k"]),
        ({"vignetting": {"k": 1.5}}, ["effects.vignetting.k", "1.5", "0 to 0.95"]),
        ({"vignetting": {"k": float("nan")}}, ["effects.vignetting.k", "out of range"]),
        ({"vignetting": {"k": "a lot"}}, ["effects.vignetting.k", "not a number"]),
        ({"black_level": {"offset_e": 3.0}}, ["effects.black_level.offset_e", "offset_DN"]),
    ],
)
def test_a_wrong_table_is_one_clear_line(table: dict[str, dict[str, object]], words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        active_effects(scene(**table), "rig.toml")
    assert "\n" not in str(error.value)
    for word in ["rig.toml", *words]:
        assert word in str(error.value)


def test_effects_of_one_stage_act_in_the_scenes_order() -> None:
    listed = scene(hot_pixels={"fraction": 0.1}, black_level={"offset_DN": 3.0}, vignetting={"k": 0.2})
    assert [entry.effect.id for entry in active_effects(listed)] == ["hot_pixels", "black_level", "vignetting"]


def test_tables_come_from_toml(tmp_path: Path) -> None:
    text = resource("scenes", "thesis.toml").read_text(encoding="utf-8")
    path = tmp_path / "dull.toml"
    path.write_text(text + "\n[effects.vignetting]\nk = 0.25\ncentre_offset_px = [31.0, -12]\n", encoding="utf-8")
    (entry,) = active_effects(load_scene(path), path)
    assert entry.parameters.model_dump() == {"k": 0.25, "exponent": 2.0, "centre_offset_px": (31.0, -12.0)}


# --- what each does --------------------------------------------------------------------------------------------------


def run(name: str, **values: object) -> object:
    effect = all_effects()[name]
    return effect.apply(value_of(effect.stage), effect.parameters(**values), context())


def test_vignetting_about_a_moved_centre() -> None:
    light = value_of(Stage.SENSOR_LIGHT)
    got = run("vignetting", k=0.31, centre_offset_px=(7.0, -4.0)).irradiance / light.irradiance  # type: ignore[attr-defined]
    # Centre of the frame (30, 23), moved to (37, 19): the farthest corner is bottom left.
    assert got[19, 37] == pytest.approx(1.0, abs=1e-12)
    assert got[46, 0] == pytest.approx(0.69, abs=1e-12)
    assert got[19, 37 + 10] == pytest.approx(1 - 0.31 * 100 / (37**2 + 27**2))
    steep = run("vignetting", k=0.31, centre_offset_px=(7.0, -4.0), exponent=3.4).irradiance / light.irradiance  # type: ignore[attr-defined]
    assert steep[46, 0] == pytest.approx(0.69, abs=1e-12)
    assert steep[19, 37 + 10] == pytest.approx(1 - 0.31 * (10 / np.hypot(37, 27)) ** 3.4)


def test_ambient_light_adds_a_plane() -> None:
    light = value_of(Stage.PLATE_LIGHT)
    got = run("ambient_light", radiance_W_per_mm2_sr=0.02, gradient=(1.3, -0.7))
    added = got.radiance - light.radiance  # type: ignore[attr-defined]
    x, y = (40 - 21.3) / 77.7, (9 - 30.1) / 77.7
    # Subtraction of numbers up to 900 leaves 2e-13.
    assert added[9, 40] == pytest.approx(0.02 * (1 + 1.3 * x - 0.7 * y), abs=1e-12)
    assert got.variance is light.variance or np.array_equal(got.variance, light.variance)  # type: ignore[attr-defined]
    bowed = run("ambient_light", radiance_W_per_mm2_sr=0.02, gradient=(1.3, -0.7), bow=-2.6)
    more = bowed.radiance - got.radiance  # type: ignore[attr-defined]
    assert more[9, 40] == pytest.approx(-0.02 * 2.6 * (x**2 + y**2), abs=1e-12)
    steep = run("ambient_light", radiance_W_per_mm2_sr=0.02, gradient=(-5.0, 0.0))
    assert (steep.radiance - light.radiance).min() >= -1e-12  # type: ignore[attr-defined]


def test_room_light_may_be_even_on_the_sensor() -> None:
    """The lens leaves cos^4 of an even radiance; bowed by 2 it is 1 - tan^4: as even as a black level."""
    rig = scene()
    lens = rig.camera.lens.model_copy(update={"distortion": Distortion(), "vignetting_k": 0.0})
    camera = rig.camera.model_copy(update={"lens": lens})
    view = Projection.of(camera, rig.plate).ideal_view()
    nothing = np.zeros(view.shape, np.float32)
    dark = PlateLight(radiance=nothing, variance=nothing, focal_px=view.focal_px, principal_point=view.principal_point)
    effect = all_effects()["ambient_light"]
    veils = (effect.parameters(radiance_W_per_mm2_sr=1e-3, bow=bow) for bow in (0.0, 2.0))
    even, bowed = (form_image(effect.apply(dark, veil, context()), camera, rig.plate) for veil in veils)
    tangent2 = np.sqrt(even.irradiance.max() / even.irradiance) - 1.0
    assert tangent2.max() > 0.05
    expected = 1.0 - (tangent2 / (1 + tangent2)) ** 2
    np.testing.assert_allclose(bowed.irradiance / bowed.irradiance.max(), expected, atol=3e-3)


def test_black_level_moves_every_number() -> None:
    got = run("black_level", offset_DN=-11.25)
    np.testing.assert_allclose(got - value_of(Stage.READOUT), -11.25, atol=1e-12)  # type: ignore[operator]


def test_hot_pixels_are_as_many_and_as_hot_as_said_and_stay() -> None:
    effect = all_effects()["hot_pixels"]
    parameters = effect.parameters(fraction=0.04, rate_e_per_s=5000.0)
    dark = np.zeros((500, 600))
    scene_ = scene()
    one = effect.apply(dark, parameters, Context(scene_, seed=5, index=0))
    np.testing.assert_array_equal(one, effect.apply(dark, parameters, Context(scene_, seed=5, index=77)))
    assert (one != effect.apply(dark, parameters, Context(scene_, seed=6))).any()
    hot = one > 0
    n = dark.size
    assert hot.mean() == pytest.approx(0.04, abs=5 * np.sqrt(0.04 * 0.96 / n))
    mean = 5000.0 * scene_.camera.exposure_ms * 1e-3
    assert one[hot].mean() == pytest.approx(mean, rel=5 / np.sqrt(hot.sum()))
    more = effect.apply(dark, effect.parameters(fraction=0.08, rate_e_per_s=5000.0), Context(scene_, seed=5))
    assert (more[hot] == one[hot]).all()
