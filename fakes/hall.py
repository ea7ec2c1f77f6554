"""A hall that nobody has measured: drawn from a seed about a cell file, and the sheet of it.

The drawn cell is the truth, as a cell file; settings of its devices are sizes of its machine. The
sheet has all that a person in the hall knows: makes, addresses, the drawing of the fixed nests in
{W}, the rail by tape, the clear zones. Each subject has draws of its own, so that a further one
changes no other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from fakes.traps import coupled, with_sizes
from fakes.truth.machine import cell_machine
from fakes.truth.noise import KeyedNoise
from fakes.truth.transforms import Array, frame, rotation
from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.cell.surroundings import KeepOut
from hilcell.cell.tables import Pose


class ClearZones(msgspec.Struct, frozen=True, kw_only=True):
    """The room that a person has walked: where no arm and no slide can touch anything."""

    around_axis_1_mm: float  # radius, along the whole travel
    above_plate_mm: tuple[float, float]  # heights above the plate that carries the robot
    rail_bed_mm: tuple[float, float]  # width, and height above the floor
    plate_mm: tuple[float, float]  # along and across the rail


class Box(msgspec.Struct, frozen=True, kw_only=True):
    """A volume that the arm keeps out of, by tape: two opposite corners, fixed in {W}, or on the
    slide about axis 1 on the plate.
    """

    name: str
    on_slide: int
    from_mm: tuple[float, float, float]
    to_mm: tuple[float, float, float]

    @property
    def row(self) -> str:
        ends = ",".join(f"{each:g}" for each in (*self.from_mm, *self.to_mm))
        return f"{self.name},{self.on_slide},{ends}"


class Hole(msgspec.Struct, frozen=True, kw_only=True):
    """A hole of the part that stands in front of the slide, in {W}; the normal leaves the part."""

    name: str
    at_mm: tuple[float, float, float]
    normal: tuple[float, float, float]

    @property
    def row(self) -> str:
        return f"{self.name}," + ",".join(f"{each:.4f}" for each in (*self.at_mm, *self.normal))


class Sheet(msgspec.Struct, frozen=True, kw_only=True):
    """A person's knowledge of a hall before anything is switched on; lengths mm."""

    drivers: dict[str, str]  # by table
    addresses: dict[str, dict[str, object]]  # options of the drivers, by table
    control: str  # of the simulated cell: its time
    robot: str
    reflector: str
    floor: list[Nest]
    bar: list[Nest]
    length: list[dict[str, object]]
    slide: list[str]  # nests whose places are unknown
    travel_mm: float  # by tape, within 5
    room_mm: float  # likewise: from the slide to the nearer end
    speed_mm_s: float
    acceleration_mm_s2: float
    clear: ClearZones
    volumes: list[Box]
    teach: list[str]  # volumes whose corners a reflector reaches, and no tape
    holes: list[Hole]

    def files(self) -> dict[str, str]:
        """Return the sheet as files by name: to be read, to be computed with, and the lists."""
        drawing = ["name,x_mm,y_mm,z_mm"]
        drawing += [f"{n.name},{n.x_mm},{n.y_mm},{n.z_mm}" for n in [*self.floor, *self.bar]]
        ends = ",".join(f"{end}_{axis}_mm" for end in ("from", "to") for axis in "xyz")
        volumes = [f"name,on_slide,{ends}", *(each.row for each in self.volumes)]
        encoded = msgspec.json.format(msgspec.json.encode(self)).decode()
        return {
            "hall.txt": self.text(),
            "hall.json": f"{encoded}\n",
            "nests.csv": "\n".join([*drawing, ""]),
            "volumes.csv": "\n".join([*volumes, ""]),
            "holes.csv": "\n".join(
                ["name,x_mm,y_mm,z_mm,nx,ny,nz", *(each.row for each in self.holes), ""]
            ),
        }

    def text(self) -> str:
        zone, places = self.clear, [*self.floor, *self.bar]
        rows = [f"  {n.name:4} {n.x_mm:10.1f} {n.y_mm:10.1f} {n.z_mm:10.1f}" for n in places]
        bars = [
            f"  {' to '.join(each['nests'])}: {each['length_mm']} mm at 20 C, standard uncertainty "  # type: ignore[arg-type]
            f"{each['u_mm']} mm, certificate {each['certificate']}"
            for each in self.length
        ]
        devices = [
            f"  {table:8} {self.drivers[table]:14} "
            + ", ".join(f"{key} {value}" for key, value in address.items())
            for table, address in self.addresses.items()
        ]
        low_mm, high_mm = zone.above_plate_mm
        return "\n".join(
            [
                "Sheet of the hall (lengths mm)",
                "Devices: driver and address",
                *devices,
                f"  control channel of the simulation: {self.control}",
                f"Robot: {self.robot}",
                f"Reflectors: {self.reflector}, one in each nest and one on the flange",
                "Drawing of the fixed nests in {W}, each within 0.2 mm:",
                *rows,
                "Scale bars:",
                *bars,
                f"Nests on the slide, places unknown: {', '.join(self.slide)}",
                f"Rail: travel {self.travel_mm:.0f} by tape, within 5",
                f"  the slide stands {self.room_mm:.0f} from the nearer end",
                f"Slide: at most {self.speed_mm_s:g} mm/s and {self.acceleration_mm_s2:g} mm/s^2",
                f"Clear along the whole travel: {zone.around_axis_1_mm:g} around axis 1",
                f"  from {low_mm:g} to {high_mm:g} above the plate",
                "Plate {:g} x {:g}, rail bed {:g} wide and {:g} high".format(
                    *zone.plate_mm, *zone.rail_bed_mm
                ),
                f"  by tape in volumes.csv: {', '.join(each.name for each in self.volumes)}",
                f"  to be taught with a reflector: {', '.join(self.teach)}",
                f"Part before the slide, {len(self.holes)} holes in {{W}} by drawing: holes.csv",
                "",
            ]
        )


def draw_cell(cell: Cell, seed: int) -> Cell:
    """Return the drawn cell: the truth of a hall, about the values of ``cell``."""
    noise = KeyedNoise(seed, "hall")
    cell = _draw_rail(cell, noise.generator("rail"))
    cell = _draw_places(cell, noise)
    cell = _draw_robot(cell, noise.generator("robot"))
    coupled_share = 0.25  # of all robots
    if noise.generator("coupling").uniform() < coupled_share:
        cell = coupled(cell)
    drawing_mm = 0.05  # 1 sigma of a coordinate: no nest is 0.2 mm off its place in the drawing
    level_mm = 0.0
    return with_sizes(cell, mounting={"floor_nest_mm": drawing_mm, "tracker_mm": level_mm})


def _draw_rail(cell: Cell, rng: np.random.Generator) -> Cell:
    shorter_mm, longer_mm = 500.0, 400.0
    travel_mm = float(round(cell.rail.travel_max_mm + rng.uniform(-shorter_mm, longer_mm)))
    drive_node, strip_node = rng.choice(np.arange(1, 127), 2, replace=False).tolist()
    sign, strip_sign = rng.choice([-1.0, 1.0], 2).tolist()
    counts_per_mm = sign * float(rng.choice([400.0, 500.0, 1000.0, 1638.4, 2000.0]))
    fastest_mm_s, fastest_mm_s2 = 600.0, 3000.0
    device = {
        "drive_node": drive_node,
        "strip_node": strip_node,
        "counts_per_mm": counts_per_mm,
        "counts_per_turn": int(rng.choice([4096, 10_000, 20_000])),
        "speed_unit": str(rng.choice(["counts/s", "0.1 counts/s", "rpm"])),
        "states_units": bool(rng.integers(2)),
        "strip_counts_per_mm": strip_sign * float(rng.choice([100.0, 200.0, 1000.0])),
        "strip_zero_mm": float(round(rng.uniform(-800.0, 800.0), 2)),
        "absolute": bool(rng.integers(2)),
        "homing_methods": [17, 35, 37],
        "motor_mm_s": fastest_mm_s,
        "motor_mm_s2": fastest_mm_s2,
    }
    stands_mm = float(round(travel_mm * rng.uniform(0.3, 0.6), 2))
    rail = msgspec.structs.replace(cell.rail, travel_max_mm=travel_mm)
    cell = msgspec.structs.replace(cell, rail=rail)
    return with_sizes(cell, rail_device=device, rail={"power_on_mm": stands_mm})


def _draw_places(cell: Cell, noise: KeyedNoise) -> Cell:
    """Turn the rail with base and tracker about the nests, then move each of them."""
    layout, rng = cell.layout, noise.generator("layout")
    turned_rad = math.radians(25.0) * rng.uniform(-1.0, 1.0)
    R = rotation(np.array([0.0, 0.0, turned_rad]))
    middle_mm = np.array([0.0, 400.0, 0.0])  # of the hall
    along = R @ np.array(layout.rail_direction)
    beside_mm = np.array([layout.base.x_mm, 0.0, layout.base.z_mm])
    beside_mm = beside_mm + rng.uniform(-1.0, 1.0, 3) * np.array([250.0, 250.0, 80.0])
    base_mm = middle_mm + R @ beside_mm - cell.rail.travel_max_mm / 2 * along
    askew_deg = 3.0  # the robot on its plate
    base = _pose(base_mm, math.degrees(turned_rad) + askew_deg * rng.uniform(-1.0, 1.0))
    rng = noise.generator("tracker")
    of_tracker_mm = np.array([cell.tracker.pose.x_mm, 0.0, cell.tracker.pose.z_mm])
    of_tracker_mm = of_tracker_mm + rng.uniform(-1.0, 1.0, 3) * np.array([800.0, 1800.0, 450.0])
    tracker = _pose(middle_mm + R @ of_tracker_mm, rng.uniform(-180.0, 180.0))
    rng = noise.generator("nests")
    floor = [
        _moved(nest, rng.uniform(-1.0, 1.0, 3) * reach_mm)
        for nest, reach_mm in zip(
            layout.floor,
            # {W}: the first nest is its origin, the second lies on its x, the third in its plane
            np.array([[0, 0, 0], [150, 0, 0], [150, 100, 0], [200, 200, 150]], dtype=float),
            strict=True,
        )
    ]
    shift_mm = rng.uniform(-1.0, 1.0, 3) * np.array([150.0, 150.0, 100.0])
    bar = [_moved(nest, shift_mm) for nest in layout.bar]
    slide = [_moved(nest, rng.uniform(-40.0, 40.0, 3)) for nest in layout.slide]
    along_rail = (float(along[0]), float(along[1]), float(along[2]))
    placed = msgspec.structs.replace(
        layout, base=base, rail_direction=along_rail, floor=floor, bar=bar, slide=slide
    )
    seen = msgspec.structs.replace(cell.tracker, pose=tracker)
    around = [_turned(each, R, middle_mm) for each in cell.keep_out]
    return msgspec.structs.replace(cell, layout=placed, tracker=seen, keep_out=around)


def _turned(volume: KeepOut, R: Array, about_mm: Array) -> KeepOut:
    """Turn what is fixed in {W}; the slide carries the others."""
    if volume.frame == "slide":
        return volume
    T = frame(volume.centre)
    centre = _pose(about_mm + R @ (T[:3, 3] - about_mm), math.degrees(math.atan2(R[1, 0], R[0, 0])))
    return msgspec.structs.replace(volume, centre=centre)


def _draw_robot(cell: Cell, rng: np.random.Generator) -> Cell:
    around_rad, off_axis_mm = rng.uniform(-math.pi, math.pi), rng.uniform(80.0, 130.0)
    smr_mm = (
        float(round(off_axis_mm * math.cos(around_rad))),
        float(round(off_axis_mm * math.sin(around_rad))),
        float(round(rng.uniform(90.0, 170.0))),
    )
    stands_deg = rng.uniform(-1.0, 1.0, 6) * np.array([15.0, 8.0, 8.0, 15.0, 10.0, 40.0])
    home_deg = np.round(np.array(cell.robot.home_deg) + stands_deg, 2).tolist()
    robot = msgspec.structs.replace(cell.robot, smr_mm=smr_mm, home_deg=tuple(home_deg))
    narrower_deg = np.round(rng.uniform(0.0, 1.0, 6) * np.array([20.0, 2.0, 5.0, 40.0, 3.0, 40.0]))
    limits_deg = [
        [joint.min_deg + float(less), joint.max_deg - float(less)]
        for joint, less in zip(cell.robot.joint, narrower_deg, strict=True)
    ]
    cell = msgspec.structs.replace(cell, robot=robot)
    return with_sizes(cell, controller={"limits_deg": limits_deg})


def _pose(at_mm: Array, a_deg: float) -> Pose:
    x_mm, y_mm, z_mm = np.round(at_mm, 3).tolist()
    return Pose(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm, a_deg=a_deg)


def _moved(nest: Nest, by_mm: Array) -> Nest:
    x_mm, y_mm, z_mm = np.round(nest.xyz_mm + by_mm, 1).tolist()
    return Nest(name=nest.name, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)


def sheet_of(
    cell: Cell, seed: int, addresses: Mapping[str, dict[str, object]], control: str
) -> Sheet:
    """Return what a person knows of a drawn cell, before any trap is set in it."""
    tape_mm = 5.0
    off_mm = KeyedNoise(seed, "hall").generator("tape").uniform(-tape_mm, tape_mm)
    stands_mm = cell_machine(cell).rail.power_on_mm or 0.0
    clear = ClearZones(
        around_axis_1_mm=3300.0,
        above_plate_mm=(0.0, 4000.0),
        rail_bed_mm=(1000.0, 150.0),
        plate_mm=(900.0, 900.0),
    )
    return Sheet(
        drivers={
            "rail": cell.rail.driver,
            "robot": cell.robot.driver,
            "tracker": cell.tracker.driver,
        },
        addresses=dict(addresses),
        control=control,
        robot=cell.robot.name,
        reflector=cell.tracker.reflector,
        floor=cell.layout.floor,
        bar=cell.layout.bar,
        length=[msgspec.to_builtins(each) for each in cell.layout.length],
        slide=[nest.name for nest in cell.layout.slide],
        travel_mm=float(round(cell.rail.travel_max_mm + off_mm)),
        room_mm=float(round(min(stands_mm, cell.rail.travel_max_mm - stands_mm) + off_mm)),
        speed_mm_s=cell.rail.speed_mm_s,
        acceleration_mm_s2=cell.rail.acceleration_mm_s2,
        clear=clear,
        volumes=_by_tape(cell, clear, KeyedNoise(seed, "hall").generator("volumes")),
        teach=[] if cell.volumes is None else cell.volumes.teach,
        holes=_part(cell, stands_mm),
    )


def _part(cell: Cell, stands_mm: float) -> list[Hole]:
    """Return a row of holes at the far side of the cube, where the slide stands.

    So the safe pose, which is anywhere in a hall, is in front of the part.
    """
    T = cell.layout.nominal_base(stands_mm) @ cell.grid.centre.matrix()
    nx, ny, nz = (-T[:3, 2]).tolist()
    far_mm = cell.grid.size_mm[2] / 3.0
    holes = []
    for number, across_mm in enumerate((-100.0, 0.0, 100.0), start=1):
        x_mm, y_mm, z_mm, _ = (T @ [across_mm, 0.0, far_mm, 1.0]).tolist()
        holes.append(Hole(name=f"H{number}", at_mm=(x_mm, y_mm, z_mm), normal=(nx, ny, nz)))
    return holes


def _by_tape(cell: Cell, clear: ClearZones, rng: np.random.Generator) -> list[Box]:
    """Return what a person has measured around the arm, each end within 5 mm or a stated reserve.

    Nobody knows how the robot is turned on its plate: the bed is given wider than it is.
    """
    plate_mm, (bed_mm, bed_high_mm) = cell.layout.base.z_mm, clear.rail_bed_mm
    wide_mm, long_mm = bed_mm / 2 + 200.0, cell.rail.travel_max_mm + bed_mm
    length_mm, across_mm = (each / 2 for each in clear.plate_mm)
    room_mm, deep_mm, thick_mm = 10_000.0, 1000.0, 100.0
    stand = cell.tracker.pose
    half_mm, top_mm = 400.0, stand.z_mm + 200.0
    ends_mm = {
        "floor": (0, (-room_mm, -room_mm, -deep_mm), (room_mm, room_mm, 0.0)),
        "rail bed": (
            1,
            (-wide_mm, -long_mm, -plate_mm),
            (wide_mm, long_mm, bed_high_mm - plate_mm),
        ),
        "plate": (1, (-length_mm, -across_mm, -thick_mm), (length_mm, across_mm, 0.0)),
        "tracker": (
            0,
            (stand.x_mm - half_mm, stand.y_mm - half_mm, 0.0),
            (stand.x_mm + half_mm, stand.y_mm + half_mm, top_mm),
        ),
    }

    def taped(at_mm: tuple[float, ...]) -> tuple[float, float, float]:
        x_mm, y_mm, z_mm = np.round(np.array(at_mm) + rng.uniform(-5.0, 5.0, 3)).tolist()
        return x_mm, y_mm, z_mm

    return [
        Box(name=name, on_slide=on_slide, from_mm=taped(low_mm), to_mm=taped(high_mm))
        for name, (on_slide, low_mm, high_mm) in ends_mm.items()
    ]
