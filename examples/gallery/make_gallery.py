"""Makes the maps of this folder: run it here, then draw with the commands of docs/maps.md.

A floor plan with walls and doors, an office from a raster as a robot's map server has it, a warehouse of
racks, and a block of houses as GeoJSON.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon, box, mapping

from guided_gym import Environment, Problem, Robot, Task

FOLDER = Path(__file__).resolve().parent
WALL = 0.12


def floor_plan() -> None:
    """A flat of five rooms; a wheelchair goes from the bedroom to the bathroom."""
    walls = [
        box(0, 0, 12, WALL), box(0, 8 - WALL, 12, 8), box(0, 0, WALL, 8), box(12 - WALL, 0, 12, 8),
        box(4.4, 0, 4.4 + WALL, 1.6), box(4.4, 2.6, 4.4 + WALL, 3.4),
        box(0, 3.4, 2.4, 3.4 + WALL), box(3.4, 3.4, 8.2, 3.4 + WALL), box(9.2, 3.4, 12, 3.4 + WALL),
        box(0, 4.8, 1.2, 4.8 + WALL), box(2.2, 4.8, 6.6, 4.8 + WALL), box(7.6, 4.8, 9.4, 4.8 + WALL),
        box(10.4, 4.8, 12, 4.8 + WALL), box(5.2, 4.8, 5.2 + WALL, 8), box(8.6, 4.8, 8.6 + WALL, 8),
    ]  # fmt: skip
    furniture = [
        box(0.4, 0.4, 2.4, 2.0), box(3.4, 0.3, 4.2, 0.8),
        Polygon([(6, 1.2), (7.4, 0.9), (7.7, 2.1), (6.3, 2.4)]),
        box(9.6, 0.3, 11.6, 1.2), box(0.4, 5.6, 2.0, 7.6), box(3.4, 7.2, 5.0, 7.7), box(5.6, 6.8, 6.6, 7.7),
        box(9.0, 7.0, 10.0, 7.7), Polygon([(11.2, 5.6), (11.7, 5.8), (11.5, 6.6), (11.0, 6.4)]),
    ]  # fmt: skip
    robot = Robot.rectangle(0.9, 0.6)
    environment = Environment((0.0, 0.0, 12.0, 8.0), (*walls, *furniture))
    rooms = {
        "bedroom": box(0, 4.8, 5.2, 8), "study": box(5.2, 4.8, 8.6, 8), "bathroom": box(8.6, 4.8, 12, 8),
        "hall": box(0, 3.4, 12, 4.8), "living room": box(0, 0, 12, 3.4),
    }  # fmt: skip
    task = Task((3.0, 6.2, 0.0), (9.8, 6.0, 1.5707963267948966))
    Problem(robot, environment, task, "FloorPlan", rooms).save(FOLDER / "floor_plan.toml")


def office_raster() -> NDArray[np.uint8]:
    """(rows, columns) grey values, row 0 at the top: 0 for walls, 254 for free, 205 for unknown."""
    grid = np.full((200, 300), 254, np.uint8)

    def wall(x0: float, y0: float, x1: float, y1: float) -> None:
        row, column = int(y0 * 20), int(x0 * 20)
        grid[row : max(int(y1 * 20), row + 3), column : max(int(x1 * 20), column + 3)] = 0

    for x in (0.0, 14.85):
        wall(x, 0, x, 10)
    for y in (0.0, 9.85):
        wall(0, y, 15, y)
    for y in (3.8, 6.0):  # offices on both sides of a corridor, each with a door
        for k in range(5):
            wall(3 * k, y, 3 * k + 1.0, y)
            wall(3 * k + 2.0, y, 3 * k + 3.0, y)
    for k in range(1, 5):
        wall(3 * k, 0, 3 * k, 3.8)
        wall(3 * k, 6.0, 3 * k, 10)
    for k in range(5):  # desks
        wall(3 * k + 0.5, 0.6, 3 * k + 1.9, 1.3)
        wall(3 * k + 1.0, 8.6, 3 * k + 2.4, 9.3)
    wall(6.9, 4.3, 7.5, 4.7)  # a copier in the corridor
    rng = np.random.default_rng(7)
    speckles = rng.integers(0, [200, 300], (40, 2))  # what a laser sees that is not there
    grid[speckles[:, 0], speckles[:, 1]] = 0
    grid[150:200, 240:297] = 205  # an office that the robot never entered
    return grid[::-1]


def office() -> None:
    """A map as ROS has it, and a problem on it."""
    grid = office_raster()
    comment = b"P5\n# an office, 0.05 m a cell\n%d %d\n255\n" % (grid.shape[1], grid.shape[0])
    (FOLDER / "office.pgm").write_bytes(comment + grid.tobytes())
    (FOLDER / "office.yaml").write_text(
        "image: office.pgm\nresolution: 0.05\norigin: [-1.0, -1.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    (FOLDER / "office.toml").write_text(
        'format = "guided-gym problem 1"\nname = "Office"\n'
        "start = [0.6, 1.8, 0.0]\ngoal = [9.4, 6.4, 0.0]\n\n"
        '# A robot of 0.6 x 0.45 m.\n[robot]\nkind = "rectangle"\nlength = 0.6\nwidth = 0.45\n\n'
        '[map]\nfile = "office.yaml"\nspeckles = 3  # cells that a laser saw and that are not there\n'
    )


def warehouse() -> None:
    """Racks in rows with cross aisles; a forklift carries a pallet to the far corner."""
    racks = [
        box(3 + 7.5 * i, 2.0 + 2.7 * j, 3 + 7.5 * i + 6.0, 2.0 + 2.7 * j + 1.1)
        for i in range(4)
        for j in range(7)
    ]
    left = [box(16.6, 12.1, 17.4, 12.9), Polygon([(9.2, 6.3), (10.3, 6.0), (10.5, 6.9)])]
    environment = Environment((0.0, 0.0, 36.0, 22.0), (*racks, *left))
    truck = Robot.polygon(
        [(-0.9, -0.45), (0.5, -0.45), (1.3, -0.3), (1.3, 0.3), (0.5, 0.45), (-0.9, 0.45)], name="truck"
    )
    Problem(truck, environment, Task((1.5, 1.0, 0.0), (20.5, 12.0, 3.141592653589793)), "Warehouse").save(
        FOLDER / "warehouse.json"
    )


def city_block() -> None:
    """Houses with courtyards as GeoJSON; a robot on the pavements."""
    rng = np.random.default_rng(3)
    shapes = [("bounds", box(0, 0, 120, 90))]
    for i in range(4):
        for j in range(3):
            x, y = 8 + 28 * i, 7 + 28 * j
            w, h = rng.uniform(16, 21, 2)
            tilt = rng.uniform(-1.5, 1.5, 2)
            house = Polygon([(x, y), (x + w, y + tilt[0]), (x + w + tilt[1], y + h), (x + tilt[1], y + h)])
            if (i + j) % 2:
                yard = house.buffer(-5.0, join_style="mitre")
                gate = box(x + w / 2 - 1.2, y - 3, x + w / 2 + 1.2, y + 8)
                house = house.difference(yard).difference(gate)
            shapes.append(("obstacle", house))
    for x, y in rng.uniform([5, 5], [115, 85], (60, 2)):
        tree = Polygon([(x + 0.6 * np.cos(a), y + 0.6 * np.sin(a)) for a in np.arange(6) * np.pi / 3])
        shapes.append(("obstacle", tree))
    rows = [
        json.dumps({"type": "Feature", "properties": {"role": role}, "geometry": mapping(shape)})
        for role, shape in shapes
    ]
    text = '{"type": "FeatureCollection", "features": [\n' + ",\n".join(rows) + "\n]}\n"
    (FOLDER / "city_block.geojson").write_text(text)


if __name__ == "__main__":
    for make in (floor_plan, office, warehouse, city_block):
        make()
