"""Seeded buildings: furnished rooms, bare corridors, and floors of rooms along a corridor."""

from __future__ import annotations

import numpy as np

from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined, polygon


def random_room(rng: np.random.Generator, clutter: int | None = None) -> Shapes:
    """A furnished room around the origin.

    4 to 12 m by 4 to 9 m, turned at random, with a niche in some walls, a door into a corridor, and `clutter`
    pieces of furniture and pillars (3 to 8 where None).
    """
    length, width = rng.uniform(4.0, 12.0), rng.uniform(4.0, 9.0)
    parts = [_walls(length, width, rng)]
    for _ in range(int(rng.integers(3, 9)) if clutter is None else clutter):
        x, y = rng.uniform(-0.45, 0.45, 2) * [length, width]
        if rng.random() < 0.25:
            parts.append(circle(x, y, rng.uniform(0.08, 0.3)))
            continue
        # Most furniture stands along the walls.
        yaw = float(rng.choice([0.0, 0.5 * np.pi])) if rng.random() < 0.7 else rng.uniform(0.0, np.pi)
        parts.append(box(rng.uniform(0.4, 1.8), rng.uniform(0.3, 0.8), (x, y, yaw)))
    return joined(parts).moved((0.0, 0.0, rng.uniform(-np.pi, np.pi)))


def _walls(length: float, width: float, rng: np.random.Generator) -> Shapes:
    """Walls with a niche in some and a door in one, a corridor wall 2 m behind the door."""
    x, y = 0.5 * length, 0.5 * width
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    door_side = int(rng.integers(4))
    parts = []
    for side in range(4):
        start, end = np.array(corners[side]), np.array(corners[(side + 1) % 4])
        along = (end - start) / np.linalg.norm(end - start)
        outward = np.array([along[1], -along[0]])
        middle = start + (end - start) * rng.uniform(0.3, 0.7)
        if side == door_side:
            parts.append(polygon([start, middle - 0.5 * along], closed=False))
            parts.append(polygon([middle + 0.5 * along, end], closed=False))
            behind = 2.0 * outward
            parts.append(polygon([start + behind - 3.0 * along, end + behind + 3.0 * along], closed=False))
        elif rng.random() < 0.5:
            half, deep = rng.uniform(0.3, 0.8), rng.uniform(0.15, 0.6) * outward
            a, b = middle - half * along, middle + half * along
            parts.append(polygon([start, a, a + deep, b + deep, b, end], closed=False))
        else:
            parts.append(polygon([start, end], closed=False))
    return joined(parts)


def corridor(length: float = 100.0, width: float = 2.5) -> Shapes:
    """Two parallel walls along x around the origin, metres; nothing tells where along them one is."""
    x, y = 0.5 * length, 0.5 * width
    return Shapes(np.array([[-x, -y, x, -y], [-x, y, x, y]], dtype=np.float64))


def random_floor(rng: np.random.Generator, rooms: int = 6, width: float = 2.2) -> tuple[Shapes, Array]:
    """A corridor along x with `rooms` furnished rooms on either side, and a round through some of them.

    Returns
    -------
    shapes, waypoints (K, 2) metres : a path that keeps clear of walls and furniture and ends where it began.
    """
    parts: list[Shapes] = []
    doors: dict[int, list[float]] = {1: [], -1: []}
    visits: list[tuple[float, Array]] = []
    y = 0.5 * width
    ends = []
    for side in (1, -1):
        x = 0.0
        for _ in range(rooms):
            length, depth = rng.uniform(3.5, 8.0), rng.uniform(3.5, 7.0)
            door = x + rng.uniform(1.0, length - 1.0)
            doors[side].append(door)
            far, inner = side * (y + depth), side * y
            walls = polygon([(x, inner), (x, far), (x + length, far), (x + length, inner)], closed=False)
            parts.append(walls)
            centre = np.array([x + 0.5 * length, side * (y + 0.4 * depth)])
            parts.extend(_furniture(rng, (x, x + length), sorted((inner, far)), door, centre))
            visits.append((door, np.array([[door, 0.0], [door, side * (y + 0.8)], centre])))
            x += length
        ends.append(x)
    for side in (1, -1):
        edges = [-2.0]
        for door in doors[side]:
            edges += [door - 0.5, door + 0.5]
        edges.append(max(ends) + 2.0)
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            parts.append(polygon([(a, side * y), (b, side * y)], closed=False))
    for x in (-2.0, max(ends) + 2.0):
        parts.append(polygon([(x, -y), (x, y)], closed=False))
    path = [np.array([[0.0, 0.0]])]
    for _, inside in sorted(visits, key=lambda visit: visit[0]):
        path += [inside, inside[-2::-1]]
    path.append(np.array([[0.0, 0.0]]))
    return joined(parts), np.concatenate(path)


def _furniture(
    rng: np.random.Generator, xs: tuple[float, float], ys: list[float], door: float, keep: Array
) -> list[Shapes]:
    """Pieces inside a room, clear of the way from the door to `keep`."""
    parts = []
    entrance = np.array([door, ys[0] if abs(ys[0]) < abs(ys[1]) else ys[1]])
    for _ in range(int(rng.integers(2, 6))):
        spot = np.array([rng.uniform(xs[0] + 0.3, xs[1] - 0.3), rng.uniform(ys[0] + 0.3, ys[1] - 0.3)])
        way = entrance + np.linspace(0.0, 1.0, 20)[:, None] * (keep - entrance)
        if np.linalg.norm(way - spot, axis=1).min() < 1.1:
            continue
        parts.append(box(rng.uniform(0.3, 1.0), rng.uniform(0.3, 0.6), (*spot, rng.uniform(0.0, np.pi))))
    return parts
