"""A cell for the approach loop: the mock base, and images that the mock camera renders."""

from collections.abc import Callable

import numpy as np

from localization_scene import CAMERA, CELL, T_OPTICAL, base_facing
from skinplan.errors import NoImageError
from skinplan.localization.loop import ApproachLoop, ApproachSettings
from skinplan.localization.loop_cell import View
from skinplan.mock.base import BaseConfig, MockBase
from skinplan.mock.camera import MockCamera
from skinplan.part.defaults import default_fixture, default_placement
from skinplan.transforms import inverse

#: The default fixture of a panel of the size of the paper's fuselage section, and its place.
BOUNDS = np.array([[-1.45, -0.4, -0.1], [1.45, 0.4, 0.1]])
FIXTURE = default_fixture(BOUNDS)
T_MAP_PANEL = default_placement(BOUNDS)
# A start that is nearer leaves no room for the stopping error: the approach refuses to move there.
START_ROOM_M = 0.3
SETTINGS = ApproachSettings(
    CELL.quality.threshold, CELL.quality.max_attempts, max_misses=3, may_move=True, images=2
)


class SimulatedCell:
    """What the loop needs of a cell; keeps what happened.

    Attributes:
        goals: Where the base was sent.
        nearest_m: Least distance of the camera from the marker plane on every way it was driven,
            its turns included [m].
        way_m: That of every drive [m].
        watching: Whether images are looked at while driving.
        told_estimates: The loop's estimates.
    """

    def __init__(self, seed: int, start, *, slips=0.0, lost=0.0, fixture=FIXTURE, cell=CELL):
        self.base = MockBase(BaseConfig(slip_probability=slips), cell, seed, start)
        self.camera = MockCamera(cell.camera, fixture, seed)
        self._random = np.random.default_rng([seed, 7])
        self._lost = lost
        self.now_s = 0.0
        self.goals: list[np.ndarray] = []
        self.looks = 0
        self.told_estimates: list = []
        self.nearest_m = np.inf
        self.way_m: list[float] = []
        self.watching = False
        self.change_image: Callable[[np.ndarray, int], np.ndarray] = lambda image, _: image

    def distance_m(self) -> float:
        """How far the camera is from the marker plane."""
        return float(-(self.base.true @ T_OPTICAL)[1, 3] + T_MAP_PANEL[1, 3])

    def look(self, after_s: float, is_cancelled) -> View:
        self.looks += 1
        for _ in range(20):
            self.now_s = max(self.now_s, after_s) + 0.1
            if self._random.uniform() >= self._lost:
                break
        else:
            raise NoImageError("an image was waited for, none came")
        truth = inverse(self.base.true @ T_OPTICAL) @ T_MAP_PANEL
        image = self.change_image(self.camera.render(truth), self.looks)
        return View(image, CAMERA, "optical", self.now_s, 0.05)

    def lookup(self, target: str, source: str) -> np.ndarray:
        known = {
            ("map", "base_link"): self.base.believed,
            ("base_link", "optical"): CELL.camera.T_base_link_optical,
        }
        return known[target, source]

    def drive(self, T_map_base_link, is_cancelled) -> bool:
        self.goals.append(T_map_base_link)
        self.base.goal(T_map_base_link, self.now_s)
        end_s = self.now_s + self.base.remaining_s
        self.way_m.append(np.inf)
        for now_s in np.linspace(self.now_s, end_s, 8 if self.watching else 80)[1:]:
            self.base.step(float(now_s))
            self.now_s = float(now_s)
            self.way_m[-1] = min(self.way_m[-1], self.distance_m())
            self.nearest_m = min(self.nearest_m, self.way_m[-1])
            if is_cancelled():
                self.base.cancel()
                self.now_s += self.base.remaining_s
                self.base.step(self.now_s)
                return False
        return True

    def glance(self) -> View | None:
        if not self.watching:
            return None
        truth = inverse(self.base.true @ T_OPTICAL) @ T_MAP_PANEL
        image = self.change_image(self.camera.render(truth), self.looks)
        return View(image, CAMERA, "optical", self.now_s, 0.05)

    def seen(self, sighting, view) -> None:
        pass

    def told(self, estimate) -> None:
        self.told_estimates.append(estimate)

    def loop(
        self,
        settings=SETTINGS,
        fixture=FIXTURE,
        is_cancelled=lambda: False,
        config=CELL,
        last_image=None,
    ):
        return ApproachLoop(self, config, fixture, settings, is_cancelled, last_image)


def random_start(seed: int) -> np.ndarray:
    """Up to 3 m away, up to 60 degrees aside, turned a little off; with room before d_min."""
    random = np.random.default_rng(seed)
    low, high = [-0.8, 0.9, -np.pi / 3, -0.15], [0.8, 3.0, np.pi / 3, 0.15]
    while True:
        x, distance, angle, turn = random.uniform(low, high)
        if distance * np.cos(angle) >= CELL.quality.distance_min_m + START_ROOM_M:
            return base_facing(x, distance, angle, turn)
