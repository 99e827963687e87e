"""What a message may hold at all: a check for each type, made from its definition, before anything looks at it.

A type's check is written as source text from `get_fields_and_field_types`, field by field, and compiled once; a laser
scan then costs a microsecond. What holds for all types is derived: floats are finite and of a magnitude, strings and
lists have a longest length, times are times, covariances are covariances. `LIMITS` has what a type's fields bear
beyond that.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np

from estimation.errors import InputError
from registration.laser.scan import FARTHEST
from whereabouts.nodes.messages.message_types import message_class

Check = Callable[[Any], None]
# Longest serialised message, bytes, and string and name of a frame, characters.
PAYLOAD, TEXT, FRAME = 1 << 28, 4096, 256
# Most elements of a list of numbers or strings, and of messages.
NUMBERS, MESSAGES = 1_000_000, 20_000
POSITION = FARTHEST
"""m: a robot does not leave a square of 1,000 km to each side, and its numbers stay exact to a nanometre."""
GENERIC = 1e12  # magnitude of a number of which nothing else is known
VARIANCE = 1e15
TOLERANCE = 1e-6  # share of its largest entry by which a covariance may be asymmetric or indefinite
SHARE = (-0.01, 1.01)  # a probability, with rounding
PROBABILITY = re.compile(r"^(.+_)?probabilit(y|ies)$|^(likelihood|fitness|visible_share)$")
SEQUENCE = re.compile(r"^sequence<(.*?)(?:, \d+)?>$")
FIXED = re.compile(r"^(.*)\[(\d+)\]$")
FLOATS = ("float", "double", "float32", "float64")
WORDS = ("string", "wstring")
ELEMENT = 200  # bytes of a message or a string in a list, more or less
# What is told apart in a list by it, so that a complaint can name it.
NAMES = ("id", "label", "object_id", "child_frame_id")

Limit = tuple[float, float] | int | None
_BOX: dict[str, Limit] = dict.fromkeys("xyz", (-POSITION, POSITION))
# By type and field: span of a number (None: any, also NaN and infinity), or the most elements of a list.
LIMITS: dict[str, dict[str, Limit]] = {
    "geometry_msgs/Point": _BOX,
    "geometry_msgs/Point32": _BOX,
    "geometry_msgs/Vector3": _BOX,
    "geometry_msgs/Quaternion": dict.fromkeys("xyzw", (-1e3, 1e3)),
    "builtin_interfaces/Time": {"sec": (0, 2**31), "nanosec": (0, 999_999_999)},
    "builtin_interfaces/Duration": {"sec": (-(2**31), 2**31), "nanosec": (0, 999_999_999)},
    "sensor_msgs/LaserScan": {
        "angle_min": (-100.0, 100.0), "angle_max": (-1e5, 1e5), "angle_increment": (-7.0, 7.0),
        "range_min": (-1.0, POSITION), "range_max": (0.0, np.inf), "scan_time": None, "time_increment": None,
        "ranges": None, "intensities": None,
    },
    "sensor_msgs/PointCloud2": {
        "height": (0, 1 << 24), "width": (0, 1 << 24), "point_step": (0, 4096), "fields": 64, "data": PAYLOAD,
    },
    "sensor_msgs/Image": {
        "height": (0, 1 << 16), "width": (0, 1 << 16), "step": (0, 1 << 20), "data": PAYLOAD,
    },
    "sensor_msgs/CompressedImage": {"data": PAYLOAD},
    "sensor_msgs/CameraInfo": {"height": (0, 1 << 16), "width": (0, 1 << 16), "d": 64},
    "nav_msgs/MapMetaData": {"width": (0, 1 << 16), "height": (0, 1 << 16), "resolution": (1e-3, 100.0)},
    "nav_msgs/OccupancyGrid": {"data": 1 << 26},
    # One transform that makes no sense takes nothing from the others: the buffer checks each by itself.
    "tf2_msgs/TFMessage": {"transforms": 1000},
    "whereabouts_msgs/FieldOfView": {
        "range_min": (0.0, POSITION), "range_max": (0.0, np.inf), "horizontal_angle": (0.0, 7.0),
        "vertical_angle": (0.0, 7.0),
    },
    "whereabouts_msgs/DiscreteDistribution": {"values": 1000, "probabilities": 1000},
    "whereabouts_msgs/GaussianDistribution": {"mean": 32, "covariance": 1024},
    # Detectors score as they like; the reader makes probabilities of it.
    "vision_msgs/ObjectHypothesis": {"score": (0.0, GENERIC)},
}  # fmt: skip
APART = ("tf2_msgs/TFMessage",)
# Of a field that is a message, the only part that has to make sense. Bases put -1, NaN or nonsense for covariances that
# they do not know; who reads those (`stated_covariance`) takes them for unknown, and most only want the pose.
PARTS = {"nav_msgs/Odometry": {"pose": "pose", "twist": "twist"}}


class Envelope:
    """The check of one message, request or goal type."""

    def __init__(self, kind: Any) -> None:
        self.check: Check = _compiled(kind)
        fields = kind.get_fields_and_field_types()
        self._lists = [name for name, told in fields.items() if SEQUENCE.match(told)]

    def size(self, message: Any) -> int:
        """Bytes a message takes, more or less: those of its lists."""
        lists = [getattr(message, name) for name in self._lists]
        return 64 + sum(len(values) * getattr(values, "itemsize", ELEMENT) for values in lists)


@cache
def envelope(kind: Any) -> Envelope:
    """The check of a type, made when it is first asked for."""
    return Envelope(kind)


def type_name(kind: Any) -> str:
    """Such as "sensor_msgs/LaserScan"."""
    return f"{kind.__module__.partition('.')[0]}/{kind.__name__}"


@cache
def _compiled(kind: Any) -> Check:
    """The check of a type: straight-line code, one piece for each field."""
    owner = type_name(kind)
    space: dict[str, Any] = {
        "outside": _outside, "text": _text, "words": _words, "numbers": _numbers, "covariance": _covariance,
        "gaussian": _gaussian, "within": _within, "each": _each, "inf": np.inf,
    }  # fmt: skip
    lines = ["def check(m):"]
    for name, told in kind.get_fields_and_field_types().items():
        lines += [f"    {line}" for line in _lines(owner, name, told, space)]
    if owner == "whereabouts_msgs/GaussianDistribution":
        lines.append("    gaussian(m)")
    exec(compile("\n".join([*lines, "    return None"]), f"<envelope of {owner}>", "exec"), space)
    return space["check"]


def _lines(owner: str, name: str, told: str, space: dict[str, Any]) -> list[str]:
    """Source of one field's check, over `m`."""
    rule = LIMITS.get(owner, {}).get(name, ())
    fixed = FIXED.match(told)
    if fixed:
        side = int(np.sqrt(int(fixed[2])))
        if side * side == int(fixed[2]) and ("covariance" in name or name == "extent"):
            return [f"covariance({name!r}, m.{name}, {side})"]
        return [f"numbers({name!r}, m.{name}, {-GENERIC}, {GENERIC})"] if fixed[1] in FLOATS else []
    if sequence := SEQUENCE.match(told):
        return _list_lines(owner, name, sequence[1], rule, space)
    if "/" in told:
        part, path = PARTS.get(owner, {}).get(name), name
        if part is not None:
            told, path = _message(told).get_fields_and_field_types()[part], f"{name}.{part}"
        space[f"check_{name}"] = _compiled(_message(told))
        return [f"within({path!r}, check_{name}, m.{path})"]
    if told.startswith(WORDS):
        return [f"text({name!r}, m.{name}, {FRAME if name.endswith('frame_id') else TEXT})"]
    if rule == () and told in FLOATS:
        rule = SHARE if PROBABILITY.match(name) else (-GENERIC, GENERIC)
    if not isinstance(rule, tuple) or not rule:
        return []
    low, high = rule
    return [f"if not {low!r} <= m.{name} <= {high!r}: outside({name!r}, m.{name}, {low!r}, {high!r})"]


def _list_lines(owner: str, name: str, inner: str, rule: Any, space: dict[str, Any]) -> list[str]:
    most = rule if isinstance(rule, int) else (MESSAGES if "/" in inner else NUMBERS)
    lines = [f"if len(m.{name}) > {most}: outside({name!r}, len(m.{name}), 0, {most}, 'elements')"]
    if "/" in inner and owner not in APART:
        space[f"check_{name}"] = _compiled(_message(inner))
        lines.append(f"each({name!r}, check_{name}, m.{name})")
    elif inner.startswith(WORDS):
        lines.append(f"words({name!r}, m.{name})")
    elif inner in FLOATS and rule is not None:
        low, high = SHARE if PROBABILITY.match(name) else (-GENERIC, GENERIC)
        lines.append(f"numbers({name!r}, m.{name}, {low!r}, {high!r})")
    return lines


def _message(told: str) -> Any:
    package, _, name = told.partition("/")
    return message_class(f"{package}/msg/{name}")


def _outside(name: str, value: Any, low: float, high: float, what: str = "") -> None:
    raise InputError(
        f"{name}: a finite number from {low:g} to {high:g} expected, got {value:g} {what}".rstrip()
    )


def _within(name: str, check: Check, message: Any) -> None:
    try:
        check(message)
    except InputError as error:
        raise InputError(f"{name}.{error}") from None


def _each(name: str, check: Check, messages: Iterable[Any]) -> None:
    index, item = 0, None
    try:
        for item in messages:
            check(item)
            index += 1
    except InputError as error:
        known = next((getattr(item, word) for word in NAMES if getattr(item, word, "") != ""), None)
        which = "" if known is None else f" ({known!s:.50})"
        raise InputError(f"{name}[{index}]{which}.{error}") from None


def _text(name: str, value: str, longest: int) -> None:
    if not value:
        return
    if len(value) > longest:
        raise InputError(f"{name}: at most {longest} characters expected, got {len(value)}")
    if not value.isprintable():
        raise InputError(f"{name}: printable characters expected, got {value[:50]!r}")


def _words(name: str, values: Iterable[str]) -> None:
    for index, value in enumerate(values):
        _text(f"{name}[{index}]", value, TEXT)


def _numbers(name: str, values: Any, low: float, high: float) -> None:
    if len(values) < 16:
        for value in values:
            if not low <= value <= high:
                _outside(name, value, low, high)
        return
    array = np.asarray(values)
    smallest, largest = array.min(), array.max()
    if not (smallest >= low and largest <= high):
        _outside(name, float(smallest if not smallest >= low else largest), low, high)


def _covariance(name: str, values: Any, side: int) -> None:
    """Symmetric and not indefinite but for rounding; nothing but zeros stands for unknown."""
    matrix = np.asarray(values, dtype=np.float64).reshape(side, side)
    largest = np.abs(matrix).max()
    if largest == 0.0:
        return
    if not largest <= VARIANCE:
        raise InputError(
            f"{name}: a finite covariance with entries up to {VARIANCE:g} expected, got {largest:g}"
        )
    if np.abs(matrix - matrix.T).max() > TOLERANCE * largest:
        raise InputError(f"{name}: a symmetric matrix expected")
    if np.linalg.eigvalsh(matrix)[0] < -TOLERANCE * largest:
        raise InputError(f"{name}: a covariance without negative eigenvalues expected")


def _gaussian(message: Any) -> None:
    size, given = len(message.mean), len(message.covariance)
    if given:
        if given != size * size:
            raise InputError(f"covariance: {size * size} values expected for a mean of {size}, got {given}")
        _covariance("covariance", message.covariance, size)
