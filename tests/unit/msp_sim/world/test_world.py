"""What a ping meets, against formulas and brute force that share nothing with the code."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from msp_range.geometry import Vector
from msp_range.yaml_file import Section
from msp_sim.acoustics.materials import MATERIALS
from msp_sim.flight.scenario import Thermometer, ThermometerFault
from msp_sim.world.surfaces import Box, GroundSection, GroundStep, HalfAngle, Roughness
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import AirSection, MountedBeam, WarmLayer, World
from tests.support.known import known

DOWN = (0.0, 0.0, 1.0)
FORWARD = (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [(AirSection, "lapse_c_per_m", 6.5), (Thermometer, "warmer_by_c", 1e5), (ThermometerFault, "by_c", -1e3)],
)
def test_air_that_nobody_flies_in_is_refused(section: type[Section], key: str, value: float) -> None:
    """A lapse of kilometres written for metres, and temperatures that no message holds."""
    given = {"kind": "jump", "from_s": 0, "to_s": 1} if section is ThermometerFault else {}
    with pytest.raises(ValidationError, match=key):
        section.model_validate({**given, key: value})


def degrees(angle_deg: float) -> HalfAngle:
    return lambda range_m: math.radians(angle_deg)


def narrowing(range_m: float) -> float:
    """A beam that narrows with range as the report's: 23 deg at 0.5 m, 12.6 deg from 2 m."""
    return math.radians(12.6 + max(2.0 - range_m, 0.0) * 7.0)


def narrowing_array(ranges_m: np.ndarray) -> np.ndarray:
    return np.radians(12.6 + np.maximum(2.0 - ranges_m, 0.0) * 7.0)


def looking(
    boresight: Vector = DOWN, half_angle: HalfAngle = narrowing, position_m: Vector = (0.0, 0.0, 0.0)
) -> MountedBeam:
    return MountedBeam(position_m, boresight, half_angle)


def at(
    north_m: float = 0.0,
    east_m: float = 0.0,
    height_m: float = 2.0,
    roll_deg: float = 0.0,
    pitch_deg: float = 0.0,
    yaw_deg: float = 0.0,
    velocity: Vector = (0.0, 0.0, 0.0),
) -> Pose:
    roll_rad, pitch_rad, yaw_rad = (math.radians(angle) for angle in (roll_deg, pitch_deg, yaw_deg))
    return Pose(0.0, (north_m, east_m, -height_m), roll_rad, pitch_rad, yaw_rad, velocity)


def world(air: AirSection | None = None, **ground: Any) -> World:
    return World(GroundSection(**ground), air or AirSection())


def body_to_world(pose: Pose) -> np.ndarray:
    turns_rad = [pose.yaw_rad, pose.pitch_rad, pose.roll_rad]
    return np.asarray(Rotation.from_euler("ZYX", turns_rad).as_matrix())


@pytest.mark.parametrize(("tilt_deg", "detected"), [(12.5, True), (12.7, False)])
def test_flat_ground_gives_an_echo_up_to_the_breakaway_angle(tilt_deg: float, detected: bool) -> None:
    for roll_deg, pitch_deg in ((tilt_deg, 0.0), (-tilt_deg, 0.0), (0.0, tilt_deg), (0.0, -tilt_deg)):
        ping = world().ping(at(height_m=3.0, roll_deg=roll_deg, pitch_deg=pitch_deg), looking())
        assert ping.has_echo is detected
        assert ping.incidence_deg == pytest.approx(tilt_deg)


def test_the_breakaway_angle_is_the_one_at_the_range() -> None:
    canted = looking(boresight=(math.sin(math.radians(15)), 0.0, math.cos(math.radians(15))))
    # 12.6 deg and 7 deg more a metre below 2 m: 15 deg is reached at 1.657 m.
    assert world().ping(at(height_m=1.65), canted).has_echo
    assert not world().ping(at(height_m=1.67), canted).has_echo


def test_ground_out_of_the_beam_is_not_heard_and_still_described() -> None:
    ping = world(surface="asphalt").ping(at(height_m=2.0, pitch_deg=30), looking())
    assert not ping.has_echo
    assert ping.target == "asphalt"
    assert ping.true_range_cm == pytest.approx(200)
    assert ping.slant_range_cm == pytest.approx(200 / math.cos(math.radians(30)))
    assert ping.incidence_deg == pytest.approx(30)


def test_a_beam_into_the_sky_meets_nothing() -> None:
    ping = world(air=AirSection(ground_c=18.0, lapse_c_per_m=0.0)).ping(at(), looking((0.0, 0.0, -1.0)))
    assert ping == (False, None, None, None, None, 18.0, None, None)


def test_range_rate_is_the_change_of_the_range() -> None:
    ground = world(slope_deg=12, uphill_deg=70, boxes=(Box(centre_m=(3.0, 0.5), size_m=(1.0, 1.0), height_m=0.8),))
    velocity = (0.7, -0.4, 0.3)
    for north_m in (0.0, 2.2, 3.0):
        pose = at(north_m, 0.5, 3.0, 3, -2, 30, velocity)
        beam = looking(half_angle=degrees(25))
        step_s = 1e-5
        north_rate, east_rate, down_rate = velocity
        north_now, east_now, down_now = pose.position_ned_m
        there = (north_now + step_s * north_rate, east_now + step_s * east_rate, down_now + step_s * down_rate)
        moved = pose._replace(position_ned_m=there)
        now, then = ground.ping(pose, beam), ground.ping(moved, beam)
        assert now.has_echo
        assert now.target == then.target
        assert now.range_rate_cm_s == pytest.approx(
            (known(then.true_range_cm) - known(now.true_range_cm)) / step_s, abs=1e-2
        )
    assert world().ping(at(velocity=(0.0, 0.0, -0.5)), looking()).range_rate_cm_s == pytest.approx(50)


def test_surfaces_follow_the_steps() -> None:
    steps = (
        GroundStep(at_m=2.0, rise_m=0.5, surface="concrete"),
        GroundStep(at_m=6.0, rise_m=-0.2),
        GroundStep(at_m=8.0, surface="gravel"),
    )
    ground = world(surface="grass", steps_heading_deg=90, steps=steps)
    for east_m, height_m, surface in (
        (0, 0.0, "grass"),
        (4, 0.5, "concrete"),
        (7, 0.3, "concrete"),
        (9, 0.3, "gravel"),
    ):
        ping = ground.ping(at(-3.0, east_m, 3.0), looking(half_angle=degrees(5)))
        assert ground.elevation_m(-3.0, east_m) == pytest.approx(height_m)
        assert (ping.target, ping.true_range_cm) == pytest.approx((surface, 300 - 100 * height_m))


def test_a_box_has_a_size_and_the_ground_has_none() -> None:
    ground = world(surface="grass", boxes=(Box(surface="crate", centre_m=(5.0, 1.0), size_m=(2.0, 1.0), height_m=0.6),))
    over, away = (ground.ping(at(north_m, 1.0), looking(half_angle=degrees(20))) for north_m in (5.0, 7.0))
    assert over.target == "crate"
    assert over.target_size_cm == pytest.approx(100)
    assert (away.target, away.target_size_cm) == ("grass", None)


def test_the_side_of_a_box_that_gives_no_echo_is_still_described() -> None:
    wall = Box(surface="brick", centre_m=(4.0, 0.0), size_m=(0.2, 4.0), height_m=3.0)
    for north_m, yaw_deg, rate_cm_s in ((2.0, 30.0, -50.0), (6.0, 150.0, 50.0)):
        pose = at(north_m, yaw_deg=yaw_deg, velocity=(0.5, 0.0, 0.0))
        aslant = world(boxes=(wall,)).ping(pose, looking(FORWARD, degrees(12)))
        assert (aslant.has_echo, aslant.target) == (False, "brick")
        assert (aslant.true_range_cm, aslant.incidence_deg) == pytest.approx((190, 30))
        assert aslant.range_rate_cm_s == pytest.approx(rate_cm_s)


class Polygons:
    """A slope with a step up, a step down and two boxes, as plane polygons in space: echoes and rays without any frame
    but the world's, by plain vectors."""

    SLOPE_DEG, UPHILL_DEG, HEADING_DEG = 9.0, 65.0, 20.0
    STEPS = (GroundStep(at_m=-1.0, rise_m=1.2, surface="concrete"), GroundStep(at_m=4.0, rise_m=-0.8, surface="gravel"))
    BOXES = (
        Box(surface="crate", centre_m=(-3.2, -0.5), size_m=(1.2, 0.7), height_m=1.1, heading_deg=20),
        Box(surface="table", centre_m=(1.8, 0.8), size_m=(0.8, 1.6), height_m=0.7, heading_deg=-50),
    )

    def __init__(self) -> None:
        self.faces: list[tuple[np.ndarray, np.ndarray, str]] = []  # corners, outward normal, name
        self.edges: list[tuple[np.ndarray, np.ndarray, list[np.ndarray], str]] = []  # ends, normals beside it, name
        along = self.unit(self.HEADING_DEG)
        across = np.array([-along[1], along[0]])
        far = 60.0
        rises = np.cumsum([0.0] + [step.rise_m for step in self.STEPS])
        names = ["grass", "concrete", "gravel"]
        borders = [-far] + [step.at_m for step in self.STEPS] + [far]
        strips = []
        for first, last, rise, name in zip(borders, borders[1:], rises, names, strict=False):
            places = [a * along + b * across for a, b in ((first, -far), (last, -far), (last, far), (first, far))]
            strips.append(self.face([(*p, self.bare(p) + rise) for p in places], (0, 0, -1), name))
        for step, low, high, strip, name in (
            (self.STEPS[0], rises[0], rises[1], strips[1], "concrete"),
            (self.STEPS[1], rises[2], rises[1], strips[1], "concrete"),
        ):
            ends = [step.at_m * along + side * across for side in (-far, far)]
            outward = (*(-np.sign(step.rise_m) * along), 0.0)
            corners = [
                (*p, self.bare(p) + rise) for p, rise in zip((*ends, *ends[::-1]), (low, low, high, high), strict=True)
            ]
            self.edge(corners[2], corners[3], [strip, self.face(corners, outward, name)], name)
        for box, rise in zip(self.BOXES, rises, strict=False):
            self.box(box, rise)

    @staticmethod
    def unit(heading_deg: float) -> np.ndarray:
        return np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])

    def bare(self, place: np.ndarray) -> float:
        return math.tan(math.radians(self.SLOPE_DEG)) * float(self.unit(self.UPHILL_DEG) @ place)

    def face(self, corners: Sequence[Sequence[float]], outward: Sequence[float], name: str) -> np.ndarray:
        points = np.array([(north, east, -height) for north, east, height in corners])
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        normal *= np.sign(normal @ outward) / np.linalg.norm(normal)
        self.faces.append((points, normal, name))
        return normal

    def edge(self, start: Sequence[float], end: Sequence[float], normals: list[np.ndarray], name: str) -> None:
        self.edges.append((np.array([*start[:2], -start[2]]), np.array([*end[:2], -end[2]]), normals, name))

    def box(self, box: Box, rise: float) -> None:
        ahead = self.unit(box.heading_deg)
        aside = np.array([-ahead[1], ahead[0]])
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        feet = [box.centre_m + a * box.size_m[0] / 2 * ahead + b * box.size_m[1] / 2 * aside for a, b in signs]
        top_m = self.bare(np.array(box.centre_m)) + rise + box.height_m
        up = self.face([(*p, top_m) for p in feet], (0, 0, -1), box.surface)
        sides = []
        for p, q in zip(feet, feet[1:] + feet[:1], strict=True):
            corners = [(*p, self.bare(p) + rise), (*q, self.bare(q) + rise), (*q, top_m), (*p, top_m)]
            sides.append(self.face(corners, (*((p + q) / 2 - box.centre_m), 0.0), box.surface))
            self.edge(corners[2], corners[3], [up, sides[-1]], box.surface)
        for i, p in enumerate(feet):
            self.edge((*p, self.bare(p) + rise), (*p, top_m), [sides[i - 1], sides[i]], box.surface)

    @staticmethod
    def contains(points: np.ndarray, normal: np.ndarray, place: ArrayLike) -> bool:
        turns = [np.cross(q - p, place - p) @ normal for p, q in zip(points, np.roll(points, -1, axis=0), strict=True)]
        return bool(min(turns) >= 0 or max(turns) <= 0)

    def covered(self, place: np.ndarray) -> bool:
        """Whether a place on the ground is below a box: straight above it is a top."""
        for points, normal, name in self.faces:
            if (
                name in ("crate", "table")
                and normal[2] == -1
                and self.contains(points, normal, [*place[:2], points[0, 2]])
            ):
                return True
        return False

    def nearest(
        self, sensor: np.ndarray, axis: np.ndarray, wider_by_rad: Sequence[float]
    ) -> list[tuple[float, float, str] | None]:
        """The nearest echo, its slant range and its surface, in beams that are wider by these angles."""
        found: list[list[tuple[float, float, str]]] = [[] for _ in wider_by_rad]
        for points, normal, name in self.faces:
            over = (sensor - points[0]) @ normal
            foot = sensor - over * normal
            if over > 0 and self.contains(points, normal, foot):
                on_ground = name not in ("crate", "table")
                if not (on_ground and self.covered(foot)):
                    for by_rad, echoes in zip(wider_by_rad, found, strict=True):
                        if -normal @ axis >= np.cos(narrowing_array(over) + by_rad):
                            echoes.append((over, over / (-normal @ axis), name))
        for start, end, normals, name in self.edges:
            if any((sensor - start) @ normal > 0 for normal in normals):
                middle = np.clip((sensor - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
                length = np.linalg.norm(end - start)
                shares = np.clip(middle + np.arange(-4.0, 4.0, 0.002) / length, 0, 1)
                rays = start + shares[:, None] * (end - start) - sensor
                ranges = np.linalg.norm(rays, axis=1)
                along, half_angles = rays @ axis, narrowing_array(ranges)
                for by_rad, echoes in zip(wider_by_rad, found, strict=True):
                    inside = along >= ranges * np.cos(half_angles + by_rad)
                    if inside.any():
                        echoes.append((ranges[inside].min(), ranges[inside].min(), name))
        return [min(echoes, default=None) for echoes in found]

    def ray(self, sensor: np.ndarray, axis: np.ndarray) -> tuple[float, float, str] | None:
        found = []
        for points, normal, name in self.faces:
            if axis @ normal < 0 < (sensor - points[0]) @ normal:
                slant = (points[0] - sensor) @ normal / (axis @ normal)
                if self.contains(points, normal, sensor + slant * axis):
                    found.append((slant, (sensor - points[0]) @ normal, name))
        return min(found, default=None)


@pytest.fixture(scope="module")
def polygons() -> Polygons:
    return Polygons()


@pytest.mark.parametrize(
    ("boresight", "tilt_deg", "names"),
    [
        (DOWN, 16, {"grass", "concrete", "gravel", "crate", "table"}),
        pytest.param(
            (math.sin(0.3), 0.0, math.cos(0.3)),
            12,
            {"grass", "concrete", "gravel", "crate", "table"},
            marks=pytest.mark.slow,
        ),
        (FORWARD, 12, {"concrete", "crate", "table"}),
    ],
    ids=["down", "canted", "forward"],
)
def test_echoes_and_rays_are_those_of_polygons_in_space(
    polygons: Polygons, boresight: Vector, tilt_deg: float, names: set[str]
) -> None:
    ground = world(
        slope_deg=polygons.SLOPE_DEG,
        uphill_deg=polygons.UPHILL_DEG,
        steps_heading_deg=polygons.HEADING_DEG,
        steps=polygons.STEPS,
        boxes=polygons.BOXES,
    )
    rng, places = np.random.default_rng(11), np.random.default_rng(16)
    heard_names, met_names, compared = set(), set(), 0
    while compared < (120 if boresight is FORWARD else 100):
        north_m, east_m = rng.uniform(-5, 6), rng.uniform(-3, 3)
        over_m = rng.uniform(0.2, 1.5) if boresight is FORWARD else rng.uniform(0.8, 3.5)
        roll_deg, pitch_deg = rng.uniform(-tilt_deg, tilt_deg, 2)
        pose = at(
            north_m, east_m, ground.elevation_m(north_m, east_m) + over_m, roll_deg, pitch_deg, rng.uniform(0, 360)
        )
        position_m = places.uniform(-0.1, 0.1, 3)
        sensor = body_to_world(pose) @ position_m + pose.position_ned_m
        axis = body_to_world(pose) @ boresight
        expected, wider, narrower = polygons.nearest(sensor, axis, (0.0, 0.003, -0.003))
        if (wider and wider[2]) != (narrower and narrower[2]):
            continue  # at the limit of the beam
        compared += 1
        ping = ground.ping(pose, looking(boresight, position_m=tuple(position_m)))
        if ping.has_echo and known(ping.true_range_cm) > 400:
            continue  # further than any sensor hears, and than the edges are sampled
        assert ping.has_echo is (expected is not None)
        if expected:
            # The edges are sampled every 2 mm, and a range grows at most as fast as the way along an edge.
            assert ping.true_range_cm == pytest.approx(100 * expected[0], abs=0.21)
            assert ping.slant_range_cm == pytest.approx(100 * expected[1], abs=0.21)
            assert ping.target == expected[2]
            if expected[1] > expected[0]:  # else it is an edge's
                cosine = math.cos(math.radians(known(ping.incidence_deg)))
                assert cosine == pytest.approx(expected[0] / expected[1], abs=2e-3)
            heard_names.add(ping.target)
        met = polygons.ray(sensor, axis)
        if met and not expected:
            assert ping.slant_range_cm == pytest.approx(100 * met[0])
            assert ping.true_range_cm == pytest.approx(100 * met[1])
            assert ping.incidence_deg == pytest.approx(math.degrees(math.acos(met[1] / met[0])))
            assert ping.target == met[2]
            met_names.add(ping.target)
        down = polygons.ray(np.array(pose.position_ned_m), body_to_world(pose)[:, 2])
        assert ground.down_axis_m(pose) == pytest.approx(known(down)[0])
    assert heard_names == names
    assert len(met_names) >= 3


def test_ground_below_a_box_does_not_answer() -> None:
    """Tilted so far that the top's foot is out of the beam, over the middle of a large table."""
    ground = world(surface="grass", boxes=(Box(surface="table", centre_m=(0.0, 0.0), size_m=(9.0, 9.0), height_m=0.5),))
    ping = ground.ping(at(height_m=3.0, roll_deg=20), looking())
    assert (ping.has_echo, ping.target, ping.true_range_cm) == pytest.approx((False, "table", 250))
    # On a slope the ground's perpendicular leans under the table, and only the level top answers.
    ground = world(slope_deg=10, boxes=(Box(surface="table", centre_m=(0.0, 0.0), size_m=(9.0, 9.0), height_m=0.5),))
    ping = ground.ping(at(height_m=3.0, pitch_deg=10), looking(half_angle=degrees(5)))
    assert (ping.has_echo, ping.target) == (False, "table")


def test_air_temperature_is_the_mean_along_the_path() -> None:
    air = AirSection(ground_c=25.0, lapse_c_per_m=0.5, warm_layer=WarmLayer(bottom_m=0.3, top_m=1.2, warmer_by_c=6.0))
    ground = world(air=air)
    pose = at(height_m=4.0)
    heights_m = (np.arange(100_000) + 0.5) * 4.0 / 100_000
    profile_c = 25.0 - 0.5 * heights_m + 6.0 * ((heights_m >= 0.3) & (heights_m <= 1.2))
    assert ground.ping(pose, looking()).air_temperature_c == pytest.approx(profile_c.mean(), abs=1e-3)
    assert ground.air_temperature_c(0.5) == pytest.approx(30.75)
    assert ground.air_temperature_c(2.0) == pytest.approx(24.0)


def heights_m(over: World, pose: Pose) -> tuple[float, float | None]:
    """Straight down, and along the body's down axis [m]."""
    return over.height_m(pose), over.down_axis_m(pose)


def test_height_above_ground_straight_down_and_along_the_body() -> None:
    ground = world(boxes=(Box(centre_m=(2.0, 0.0), size_m=(1.0, 1.0), height_m=0.5),))
    level = heights_m(ground, at(height_m=3.0))
    assert level == pytest.approx((3.0, 3.0))
    vertical_m, down_axis_m = heights_m(ground, at(height_m=3.0, roll_deg=15, pitch_deg=5, yaw_deg=90))
    assert vertical_m == pytest.approx(3.0)
    assert down_axis_m == pytest.approx(3.0 / math.cos(math.radians(15)) / math.cos(math.radians(5)))
    # Above the box, and leaning so that the axis passes beside it: nose down at yaw 180 looks north.
    assert heights_m(ground, at(2.0, height_m=3.0)) == pytest.approx((2.5, 2.5))
    aside = heights_m(ground, at(2.4, height_m=3.0, pitch_deg=10))
    assert aside == pytest.approx((2.5, 3.0 / math.cos(math.radians(10))))
    assert ground.down_axis_m(at(roll_deg=180)) is None


@pytest.mark.parametrize("height_m", [0.0, 0.5])
def test_a_vehicle_on_the_ground_or_on_a_box_has_no_height(height_m: float) -> None:
    boxes = (Box(centre_m=(0.0, 0.0), size_m=(1.0, 1.0), height_m=0.5),) if height_m else ()
    ground = world(boxes=boxes)
    assert heights_m(ground, at(height_m=height_m)) == (0.0, 0.0)
    assert ground.ping(at(height_m=height_m), looking())[:2] == (True, 0.0)
    buried = ground.ping(at(height_m=height_m - 0.02), looking())
    assert buried[:2] == (True, 0.0)


def test_steps_out_of_order_and_an_upside_down_layer_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected steps in order of at_m, but 2.0 comes after 5.0"):
        GroundSection(steps=(GroundStep(at_m=5.0), GroundStep(at_m=2.0)))
    with pytest.raises(ValueError, match=r"expected top_m above bottom_m, but 1.0 is not above 2.0"):
        WarmLayer(bottom_m=2.0, top_m=1.0, warmer_by_c=3.0)


def test_rough_ground_varies_about_its_mean_from_which_heights_count() -> None:
    ground = GroundSection(surface="grass", rough={"grass": Roughness(rms_m=0.03, length_m=0.3)}, slope_deg=5.0)
    rough, smooth = World(ground, AirSection()), World(GroundSection(surface="grass", slope_deg=5.0), AirSection())
    beam = MountedBeam((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), lambda range_m: math.radians(15.0))
    off_m = []
    for i in range(2000):
        pose = Pose(0.0, (0.05 * i, 0.013 * i, -20.0), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0))
        one, other = rough.ping(pose, beam), smooth.ping(pose, beam)
        assert one.true_range_cm is not None
        assert other.true_range_cm is not None
        off_m.append((one.true_range_cm - other.true_range_cm) / 100)
        assert heights_m(rough, pose) == heights_m(smooth, pose)
        assert rough.ping(pose, beam) == one
    assert np.std(off_m) == pytest.approx(0.03, rel=0.1)
    assert np.mean(off_m) == pytest.approx(0.0, abs=0.003)
    # A tuft's place says little of the next one's.
    assert abs(np.corrcoef(off_m[:-6], off_m[6:])[0, 1]) < 0.4


def test_a_roughness_is_given_by_numbers_or_by_the_name_of_a_known_surface() -> None:
    rough = {"yard": "gravel", "pad": "concrete", "grass": {"rms_m": 0.03}}
    steps = [{"at_m": 1.0, "surface": "yard"}, {"at_m": 2.0}, {"at_m": 3.0, "surface": "pad"}]
    ground = GroundSection.model_validate({"rough": rough, "steps": steps})
    found = {name: (each.rms_m, each.length_m) for name, each in ground.rough.items()}
    assert found == {"yard": (0.01, 0.05), "pad": (0.0, 0.3), "grass": (0.03, 0.3)}
    for name in MATERIALS:
        GroundSection.model_validate({"rough": {"grass": name}})
    with pytest.raises(ValidationError, match=r"found 'gravle'; expected one of plywood, .*, gravel, snow, foam"):
        GroundSection.model_validate({"rough": {"grass": "gravle"}})


def test_a_roughness_of_a_surface_that_the_ground_does_not_have_is_refused() -> None:
    ground = {"surface": "field", "steps": [{"at_m": 1.0, "surface": "yard"}]}
    for misspelt, meant in (("yrad", "yard"), ("feild", "field"), ("gras", "grass")):
        expected = f"rough: found '{misspelt}'; expected one of field, yard, plywood, .*foam. Did you mean '{meant}'?"
        with pytest.raises(ValidationError, match=expected):
            GroundSection.model_validate({**ground, "rough": {misspelt: "gravel"}})


def test_only_the_surfaces_that_are_named_are_rough() -> None:
    ground = GroundSection(
        surface="concrete",
        rough={"grass": Roughness(rms_m=0.05)},
        steps=(GroundStep(at_m=10.0, surface="grass"),),
        boxes=(Box(surface="grass", centre_m=(20.0, 0.0), size_m=(2.0, 2.0), height_m=0.5),),
    )
    world = World(ground, AirSection())
    beam = MountedBeam((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), lambda range_m: math.radians(5.0))

    def range_cm(north_m: float) -> float | None:
        return world.ping(Pose(0.0, (north_m, 0.1, -3.0), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0)), beam).true_range_cm

    assert [range_cm(x) for x in (2.0, 3.3, 20.1)] == [pytest.approx(300), pytest.approx(300), pytest.approx(250)]
    assert range_cm(13.3) != pytest.approx(300, abs=0.05)
