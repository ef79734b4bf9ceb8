"""Widgets of the live page: a slider with its number, the plate with its LEDs, a picture with an SVG overlay."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nicegui import ui
from nicegui.element import Element

from evanesce.live.controls import Knob, led_names
from evanesce.optics.led import led_positions
from evanesce.rig import Scene

THROTTLE_S = 0.04
"""Time between two values of a moving slider [s]."""

MOVE_BY_ARROWS = """(e) => {
  const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[e.key];
  if (!step) return;
  const all = [...e.currentTarget.querySelectorAll('button')];
  const at = all.indexOf(document.activeElement);
  const next = all[(at + step + all.length) % all.length];
  if (all[at]) all[at].tabIndex = -1;
  next.tabIndex = 0;
  next.focus();
  e.preventDefault();
}"""
"""One stop of the Tab key for all LEDs; the arrow keys select the next or previous one."""


class Range(Element, component="range.js"):
    """The browser's own slider, which moves without waiting for the server, so that no step of a held key is lost.

    Parameters
    ----------
    low, high, step, value : float
    changed : callable
        Called with each new value, at most every ``THROTTLE_S``.
    """

    def __init__(self, *, low: float, high: float, step: float, value: float, changed: Callable[[float], None]) -> None:
        super().__init__()
        self._props["min"], self._props["max"], self._props["step"], self._props["start"] = low, high, step, value
        self.on("moved", lambda event: changed(float(event.args)), throttle=THROTTLE_S)

    def put(self, value: float) -> None:
        """Move the slider without an event."""
        self.run_method("put", value)


class Screen(Element, component="screen.js"):
    """Content that changes with every picture, sent without the framework's comparison of the whole page."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: dict[tuple[str, str], str] = {}

    def show(self, parts: Mapping[tuple[str, str], str]) -> None:
        """Send what has changed.

        Parameters
        ----------
        parts : mapping
            (CSS selector, "html", "text", "value" or the name of an attribute) -> text. HTML is not sanitised: it has
            to come from this package.
        """
        new = {key: text for key, text in parts.items() if key[1] == "value" or self._shown.get(key) != text}
        self._shown |= new
        if new:
            self.run_method("show", [[selector, what, text] for (selector, what), text in new.items()])


class KnobRow:
    """A label, a slider, and its value as a number with its unit.

    Parameters
    ----------
    knob : Knob
    value : float
    changed : callable
        Called with the new value when the user has changed either.
    """

    def __init__(self, knob: Knob, value: float, changed: Callable[[float], None]) -> None:
        self._knob, self._value, self._changed = knob, value, changed
        spoken = f"{knob.label} [{knob.unit}]" if knob.unit else knob.label
        with ui.element("div").classes("knob").props(f'data-knob="{knob.name}"'):
            self.label = ui.label(knob.label).classes("knob-label").props(f'title="{knob.hint}"')
            self.slider = Range(low=knob.low, high=knob.high, step=knob.step, value=value, changed=self._slid)
            self.slider.props(f'aria-label="{spoken}"')
            self.number = (
                ui.number(
                    value=value, min=knob.low, max=knob.high, step=knob.step, format=f"%.{knob.digits}f",
                    suffix=knob.unit or None, on_change=lambda e: self._take(e.value),
                )
                .props(f'dense outlined hide-bottom-space debounce=250 aria-label="{spoken}, as a number"')
                .classes("knob-number")
            )  # fmt: skip

    def _take(self, value: float | None, *, moved: bool = False) -> None:
        """Set the value from the number or, ``moved``, the slider; the other is updated, and its event is ignored."""
        if value is None or float(value) == self._value:
            return
        value = float(value)
        # The number is rounded: its event with the slider's value is not a new value.
        if abs(value - self._value) < 0.5 * 10.0**-self._knob.digits and value == round(self._value, self._knob.digits):
            return
        self._value = value
        if not moved:
            self.slider.put(value)
        self._changed(value)

    def _slid(self, value: float) -> None:
        self._take(value, moved=True)

    def part(self) -> dict[tuple[str, str], str]:
        """Return the number's text while the slider moves, for :class:`Screen`."""
        selector = f'[data-knob="{self._knob.name}"] input[type="number"]'
        return {(selector, "value"): f"{self._value:.{self._knob.digits}f}"}

    def settle(self) -> None:
        """Update the number once the slider rests: the framework compares the whole page for it."""
        self.number.value = self._value

    def show(self, value: float) -> None:
        """Show a value without calling ``changed``."""
        self._value = value
        self.slider.put(value)
        self.number.value = value


class LedMap:
    """The plate from below with its LEDs, each a switch; the selected one has a slider for its power.

    Parameters
    ----------
    scene : Scene
    powers : tuple of float
        Relative power of each LED.
    changed : callable
        Called with all powers when the user has changed one.
    """

    def __init__(self, scene: Scene, powers: tuple[float, ...], changed: Callable[[tuple[float, ...]], None]) -> None:
        self._names, self._powers, self._changed = led_names(scene), powers, changed
        self._selected = 0
        self._buttons: list[Element] = []
        width, height = scene.plate.size_mm
        along = [float(p) for at in led_positions(scene.plate, scene.leds).values() for p in at]
        pitch = scene.leds.pitch_mm / width * 250
        size = max(5, min(16, round(0.8 * pitch)))
        with ui.element("div").classes("plate-frame"), ui.element("div").classes("plate") as plate:
            plate.props('role="group" aria-label="LEDs around the plate, as the camera sees them"')
            plate.style(f"aspect-ratio: {width:g} / {height:g}")
            plate.on("keydown", js_handler=MOVE_BY_ARROWS)
            x, y = scene.finger.position_mm
            radius = scene.finger.diameter_mm / 2
            ui.element("div").classes("finger").style(
                f"left:{50 + 100 * (x - radius) / width:.2f}%; top:{50 + 100 * (y - radius) / height:.2f}%;"
                f"width:{200 * radius / width:.2f}%; height:{200 * radius / height:.2f}%"
            )
            for i, ((edge, _), position) in enumerate(zip(self._names, along, strict=True)):
                left, top = _point(edge, position, width, height)
                button = (
                    ui.element("button")
                    .classes("led")
                    .style(f"left:{left:.2f}%; top:{top:.2f}%; width:{size}px; height:{size}px")
                )
                button.props(f'type="button" role="switch" tabindex="{0 if i == 0 else -1}"')
                button.on("click", lambda _, i=i: self._toggle(i), args=[])
                button.on("focus", lambda _, i=i: self._select(i), args=[])
                self._buttons.append(button)
        knob = Knob("led_power", "", "%", 0.0, 200.0, 5.0, 0, "power of the selected LED over that of its circuit")
        self.power = KnobRow(knob, 100.0 * powers[0], self._set_power)
        with ui.element("div").classes("buttons"):
            ui.button("All on", on_click=lambda: self._set_all(1.0)).props("flat dense no-caps")
            ui.button("All off", on_click=lambda: self._set_all(0.0)).props("flat dense no-caps")
        self.show(powers)

    def show(self, powers: tuple[float, ...]) -> None:
        """Show powers without calling ``changed``."""
        self._powers = powers
        for i, (button, power) in enumerate(zip(self._buttons, powers, strict=True)):
            self._show_state(button, i, power)
        self._name_selected()

    def _show_state(self, button: Element, i: int, power: float) -> None:
        edge, number = self._names[i]
        state = f"LED {edge} {number}, {100 * power:.0f} %"
        if button.props.get("aria-label") != state:
            button.props["aria-label"] = button.props["title"] = state
            button.props["aria-checked"] = "true" if power > 0 else "false"
            button.props["data-level"] = "off" if power == 0 else "on"

    def _name_selected(self) -> None:
        edge, number = self._names[self._selected]
        self.power.label.text = f"{edge} {number}"
        self.power.show(100.0 * self._powers[self._selected])

    def _select(self, i: int) -> None:
        self._selected = i
        self._name_selected()

    def _toggle(self, i: int) -> None:
        self._selected = i
        self._set_one(i, 0.0 if self._powers[i] > 0 else 1.0)

    def _set_power(self, percent: float) -> None:
        self._set_one(self._selected, percent / 100.0)

    def _set_one(self, i: int, power: float) -> None:
        self._set_powers(tuple(power if j == i else old for j, old in enumerate(self._powers)))

    def _set_all(self, power: float) -> None:
        self._set_powers((power,) * len(self._powers))

    def _set_powers(self, powers: tuple[float, ...]) -> None:
        self.show(powers)
        self._changed(powers)


def _point(edge: str, along: float, width: float, height: float) -> tuple[float, float]:
    """Return an LED's position on the drawn plate, (left, top) [%]."""
    x, y = 50 + 100 * along / width, 50 + 100 * along / height
    return {"left": (0.0, y), "right": (100.0, y), "top": (x, 0.0), "bottom": (x, 100.0)}[edge]


class Picture:
    """A picture with an SVG overlay.

    Parameters
    ----------
    name : str
        Of the element, for style and tests.
    alt : str
        Description for screen readers.
    drawn : callable, optional
        Called when the browser has drawn a new one.
    """

    def __init__(self, name: str, alt: str, drawn: Callable[[], None] | None = None) -> None:
        self._selector = f"#picture-{name}"
        with ui.element("div").classes("picture").props(f'id="picture-{name}"'):
            image = ui.element("img").props(f'alt="{alt}" draggable="false"')
            image.on("error", js_handler="(event) => event.target.removeAttribute('src')")
            ui.element("div").classes("annotations")
        if drawn is not None:
            image.on("load", lambda _: drawn(), args=[])

    def part(self, address: str, overlay: str = "") -> dict[tuple[str, str], str]:
        """Return a picture's address and the SVG over it, for :class:`Screen`."""
        return {(f"{self._selector} img", "src"): address, (f"{self._selector} .annotations", "html"): overlay}
