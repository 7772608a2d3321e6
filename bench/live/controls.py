"""What is asked of the experiment in the page: menus, sliders, buttons."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from qpmpc.backends import available
from qpmpc.kinds import controllers
from scenarios.config import Scenario
from scenarios.consistency import band
from scenarios.livecell.commands import Act, Command, Set

Ask = Callable[[Command], None]
_NO_BOUND = 30.0
"""Where the slider of a bound on the pressing force means that there is none [N]."""
_REACH = {"x": (-8.0, 8.0), "y": (-8.0, 8.0), "z": (-20.0, 0.0)}
"""Where the sliders of the setpoint begin and end [N]."""


@dataclass(frozen=True)
class _Slider:
    """A slider for one key."""

    key: str
    label: str
    span: tuple[float, float, float]
    """From, to, step."""
    of: Callable[[Scenario], float]
    """Where it stands for a scenario."""
    asked: Callable[[float], float | tuple[float, float]]
    """Which value of the key it asks for where it stands."""


class Controls:
    """Widgets of the page; whoever has it open shares them."""

    def __init__(self, gui: Any, scenario: Scenario, ask: Ask) -> None:
        """Lay them out; what is done to them becomes a command that ``ask`` passes on."""
        self._gui, self._ask = gui, ask
        self._shown: dict[str, tuple[Any, Callable[[Scenario], Any]]] = {}
        self._paused = False
        with gui.add_folder("Controller"):
            self._menu(scenario)
        with gui.add_folder("Setpoint"):
            self._setpoint(scenario)
        with gui.add_folder("Weights, bounds, tissue"):
            self._figures(scenario)
        with gui.add_folder("What goes wrong"):
            for act in (Act.EARLY_BEAT, Act.DROPOUT, Act.SOLVER_FAILURE):
                self._button(str(act).capitalize(), act)
        with gui.add_folder("Run"):
            self._pause = gui.add_button("Pause")
            self._pause.on_click(lambda _: ask(Act.RESUME if self._paused else Act.PAUSE))
            self._button("Single step", Act.STEP)
            self._button("Reset", Act.RESET)
            self._recording = False
            self._record = gui.add_button("Record")
            self._record.on_click(lambda _: ask(Act.KEEP if self._recording else Act.RECORD))

    def show(self, scenario: Scenario) -> None:
        """Put all widgets to what is in force."""
        for widget, of in self._shown.values():
            value = of(scenario)
            if widget.value != value:
                widget.value = value

    def tell(self, *, paused: bool, recording: bool) -> None:
        """Let the two buttons that have two meanings say which."""
        if paused != self._paused:
            self._paused, self._pause.label = paused, "Go on" if paused else "Pause"
        if recording != self._recording:
            self._recording = recording
            self._record.label = "End recording" if recording else "Record"

    def _menu(self, scenario: Scenario) -> None:
        kinds = tuple(kind.name for kind in controllers())
        ready = (info.name for info in available() if info.version is not None)
        backends = tuple(dict.fromkeys((*ready, scenario.backend)))
        self._add(
            "controller.kind",
            self._gui.add_dropdown("controller", kinds, initial_value=scenario.controller.kind),
            lambda s: s.controller.kind,
        )
        self._add(
            "backend",
            self._gui.add_dropdown("backend", backends, initial_value=scenario.backend),
            lambda s: s.backend,
        )

    def _setpoint(self, scenario: Scenario) -> None:
        for axis in scenario.axes:
            now = getattr(scenario.setpoint, axis)
            low, high = _REACH[axis]
            self._slide(
                scenario,
                _Slider(
                    f"setpoint.{axis}", f"{axis} [N]", (min(low, now), max(high, now), 0.1),
                    attrgetter(f"setpoint.{axis}"), _as_it_is,
                ),
            )  # fmt: skip

    def _figures(self, scenario: Scenario) -> None:
        upper = band(scenario.controller.bounds.force, "z")[1]

        def pressing(value: float) -> tuple[float, float]:
            return (-math.inf if value >= _NO_BOUND else -value), upper

        for slider in (
            _Slider(
                "controller.force_weight", "log10 of force weight", (-2.0, 2.0, 0.1),
                lambda s: math.log10(s.controller.force_weight), _power,
            ),
            _Slider(
                "controller.increment_weight", "log10 of increment weight", (-5.0, 0.0, 0.1),
                lambda s: math.log10(s.controller.increment_weight), _power,
            ),
            _Slider(
                "controller.reference_time", "reference time [ms]", (0.0, 100.0, 1.0),
                lambda s: 1e3 * s.controller.reference_time, lambda value: 1e-3 * value,
            ),
            _Slider(
                "controller.bounds.force.z", f"press at most [N] ({_NO_BOUND:g}: any)",
                (1.0, _NO_BOUND, 0.5),
                lambda s: -band(s.controller.bounds.force, "z")[0], pressing,
            ),
            _Slider(
                "controller.bounds.command", "command within ± [m/s²]", (1.0, 40.0, 0.5),
                lambda s: band(s.controller.bounds.command, "z")[1], lambda value: (-value, value),
            ),
            _Slider(
                "cell.contact.stiffness", "stiffness of tissue [N/m]", (500.0, 6000.0, 50.0),
                lambda s: s.cell.contact.stiffness, _as_it_is,
            ),
        ):  # fmt: skip
            self._slide(scenario, slider)

    def _slide(self, scenario: Scenario, slider: "_Slider") -> None:
        low, high, step = slider.span

        def within(given: Scenario) -> float:
            return min(max(low, round(slider.of(given) / step) * step), high)

        widget = self._gui.add_slider(slider.label, low, high, step, within(scenario))
        self._add(slider.key, widget, within, slider.asked)

    def _add(
        self,
        key: str,
        widget: Any,
        of: Callable[[Scenario], Any],
        asked: Callable[[Any], Any] = lambda value: value,
    ) -> None:
        self._shown[key] = widget, of

        def ask(event: Any) -> None:
            if event.client is not None:  # by somebody, not by `show`
                self._ask(Set(key, asked(widget.value)))

        widget.on_update(ask)

    def _button(self, label: str, act: Act) -> None:
        button = self._gui.add_button(label)
        button.on_click(lambda _: self._ask(act))


def _as_it_is(value: float) -> float:
    return value


def _power(value: float) -> float:
    return float(10.0**value)
