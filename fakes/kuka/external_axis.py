"""External axis E1 of the robot's controller: the slide, with an absolute encoder and a brake."""

from __future__ import annotations

from fakes.faults import Faults
from fakes.site import Site
from fakes.truth.noise import Dither
from fakes.truth.rail_truth import RailState, RailTruth

RAIL_DRIVER = "kuka-e1"


class ExternalAxis:
    """Moves one slide; its controller's lock guards it."""

    STOP_MM_S2 = 800.0  # on a stop
    DITHER_MM, DITHER_SCOPE = 0.001, 7

    def __init__(
        self,
        rail: RailTruth,
        faults: Faults,
        lowest_mm: float,
        highest_mm: float,
        ramp_mm_s2: float,
    ) -> None:
        self._rail, self._faults, self._ramp_mm_s2 = rail, faults, ramp_mm_s2
        self._lowest_mm, self._highest_mm = lowest_mm, highest_mm
        self.held = True
        self.moving = False
        self._target_mm, self._speed_mm_s = 0.0, 0.0
        self._dither = Dither(1, self.DITHER_SCOPE)
        rail.master()

    def inside(self, target_mm: float) -> bool:
        """Whether a target lies within the software limits."""
        return self._lowest_mm <= target_mm <= self._highest_mm

    def move(self, target_mm: float, percent: int, override: float) -> None:
        """Start for a target."""
        factor = self._faults.number("robot.slide_fast") or 1.0
        self._rail.brake(closed=False)
        full_mm_s = 1890.0  # at 100 %
        self._target_mm, self._speed_mm_s = target_mm, full_mm_s * percent / 100.0 * factor
        self.moving = True
        self.override(override)

    def override(self, share: float) -> None:
        """Change the speed of a motion under way; 0 makes it stand."""
        if not self.moving:
            return
        if share > 0:
            self._rail.move(self._target_mm, self._speed_mm_s * share, self._ramp_mm_s2)
        else:
            self._rail.quick_stop(self.STOP_MM_S2)

    def stop(self) -> None:
        """Brake, and forget the target; the slide is held from now on."""
        self.held = True
        if self.moving:
            self._rail.quick_stop(self.STOP_MM_S2)
            self.moving = False

    def poll(self, share: float) -> RailState:
        """Look at the slide; ``share`` is the override, of which 0 lets no motion end."""
        state = self._rail.poll()
        if not state.moving:
            self.moving = self.moving and not share > 0
            self._rail.brake(closed=self.held)
        return state

    @property
    def seen_moving(self) -> bool:
        """Whether the slide moves, without letting time pass."""
        return not self._rail.still

    def place_mm(self, state: RailState, *, alone: bool) -> float:
        """Return the reading; at rest it dithers, by a step each time E1 is asked for ``alone``."""
        if alone:
            self._dither.step()
        return state.encoder_mm + (0.0 if state.moving else self.DITHER_MM * self._dither.counts)


def external_axis(site: Site) -> ExternalAxis | None:
    """Return the slide of a cell whose rail is the robot's axis E1, else None."""
    rail, table = site.plant.rail, site.cell.rail
    if table.driver != RAIL_DRIVER or not isinstance(rail, RailTruth):
        return None
    limit_mm = 0.5  # the software limits lie so far outside the travel
    lowest_mm, highest_mm = table.travel_min_mm - limit_mm, table.travel_max_mm + limit_mm
    return ExternalAxis(rail, site.faults, lowest_mm, highest_mm, table.acceleration_mm_s2)
