"""Times in plain words: "yesterday morning", "at nine", "since breakfast", "two hours ago", ISO 8601.

Words count from `now`, the newest moment that is known; clock times are of the last 24 hours, in local time. A part of
the day stands for its hours; "since" counts from its beginning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timedelta

from estimation.errors import InputError
from world_model.questions.answers import clean

PARTS = {
    "morning": (6, 12), "breakfast": (7, 9), "breakfast time": (7, 9), "lunch": (12, 14), "lunchtime": (12, 14),
    "afternoon": (12, 18), "teatime": (16, 17), "dinner": (18, 20), "supper": (18, 20), "evening": (18, 24),
    "night": (22, 30),
}  # fmt: skip
"""Hours of the day; after 24 those of the next."""
DAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
NUMBERS = (  # noqa: SIM905
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen "
    "seventeen eighteen nineteen twenty"
).split()
UNITS = {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0, "week": 604800.0, "month": 2592000.0}

_NUMBER = rf"(?:\d+(?:\.\d+)?|an?|half an|{'|'.join(NUMBERS)})"
_UNIT = r"(?:sec(?:ond)?s?|min(?:ute)?s?|hours?|h|days?|weeks?|months?)"
_DATE = r"\d{4}-\d{2}-\d{2}"
_ISO = rf"{_DATE}(?:[t ]\d{{2}}:\d{{2}}(?::\d{{2}}(?:\.\d+)?)?(?:z|[+-]\d{{2}}:?\d{{2}})?)?"
_PART = rf"(?:{'|'.join(sorted(PARTS, key=len, reverse=True))})"
_DAY = (
    rf"(?:today|yesterday|the day before yesterday|(?:on |last |this )?(?:{'|'.join(DAYS)})|(?:on )?{_DATE})"
)
_HOUR = rf"(?:\d{{1,2}}(?::\d{{2}}){{0,2}}|{'|'.join(NUMBERS[1:13])})"
_TIME = (
    rf"(?:(?:(?:half past |quarter past |quarter to )?{_HOUR}"
    r"(?: ?(?:am|pm|a\.m\.|p\.m\.)(?!\w)| o'?clock)?)|noon|midnight)"
    r"(?: (?:in the (?:morning|afternoon|evening)|at night))?"
)
_PHRASES = {  # of two that begin alike the longer one first
    "day_time": rf"{_DAY},?(?: {_PART})? (?:at|around|about) {_TIME}",
    "iso": rf"(?:at |on )?{_ISO}",
    "seconds": r"(?:at )?\d{6,}(?:\.\d+)?(?: s)?",
    "ago": rf"{_NUMBER} {_UNIT} (?:ago|before now)",
    "within": rf"(?:in|during|within|over|for) the (?:last|past) (?:{_NUMBER} )?{_UNIT}",
    "week": r"(?:this|last) (?:week|month)|the week",
    "time_day": rf"(?:at|around|about) {_TIME},? {_DAY}(?: {_PART})?",
    "day_part": rf"{_DAY} {_PART}",
    "last_night": r"(?:last|to)night|last night|last evening",
    "part": rf"(?:(?:in the|this|at|during|during the) )?{_PART}",
    "time": rf"(?:at|around|about) {_TIME}",
    "bare": r"(?:\d{1,2}:\d{2}(?::\d{2})?|noon|midnight)",
    "day": _DAY,
    "now": r"(?:right )?now|at the moment|currently|at present",
}
_COMPILED = {name: re.compile(pattern) for name, pattern in _PHRASES.items()}
_ANY = "|".join(f"(?:{pattern})" for pattern in _PHRASES.values())
_WORD = r"(?:since|after|before|until|till|by|from)"
_BEFORE, _AFTER = r"(?:^|(?<=[\s,]))", r"(?=$|[\s,?.!])"
_RANGE = re.compile(
    rf"{_BEFORE}(?:between|from) (?P<a>{_ANY}|{_TIME}) (?:and|to|until|till) (?P<b>{_ANY}|{_TIME}){_AFTER}"
)
_FOUND = re.compile(rf"{_BEFORE}(?:(?P<word>{_WORD}) )?(?P<phrase>{_ANY}){_AFTER}")
_SINCE_TIME = re.compile(rf"{_BEFORE}(?P<word>since|after|before|until|till|by) (?P<phrase>{_TIME}){_AFTER}")


@dataclass(frozen=True)
class Span:
    """From `start` to `end`, s; both the same for a moment. words : how it was said."""

    start: float
    end: float
    words: str = ""

    @property
    def middle(self) -> float:
        """s."""
        return 0.5 * (self.start + self.end)


def moment(words: str | float, now: float) -> Span:
    """The moment or span that words stand for. Raises InputError where they stand for none, saying what can be said."""
    if isinstance(words, (int, float)) and not isinstance(words, bool):
        return Span(float(words), float(words), str(words))
    text = " ".join(str(words).lower().split())
    text = re.sub(rf"^{_WORD} ", "", text)
    for name, pattern in _COMPILED.items():
        if pattern.fullmatch(text):
            return _span(name, text, now)
    if re.fullmatch(_TIME, text):
        return _span("time", f"at {text}", now)
    raise InputError(
        f'no time: "{clean(str(words))}"; say "yesterday morning", "at nine", "two hours ago", "since breakfast", '
        '"monday at 14:30" or 2026-11-21T09:00'
    )


def extract(text: str, now: float) -> tuple[str, Span | None, str]:
    """A question without its time, the time, and the word before it ("since"); lower-case text, single spaces."""
    found = _RANGE.search(text)
    if found:
        rest = _without(text, found)
        day = re.search(rf"{_BEFORE}{_DAY}{_AFTER}", rest)
        first, last = moment(found["a"], now), moment(found["b"], now)
        if day:
            begin = _stamp(_day(day[0], datetime.fromtimestamp(now)))
            first, last = (Span(_on(begin, each.start), _on(begin, each.end)) for each in (first, last))
            rest = _without(rest, day)
        if last.end < first.start:
            last = Span(last.start + 86400.0, last.end + 86400.0)
        return rest, Span(first.start, last.end, found[0]), "between"
    found = _SINCE_TIME.search(text) or _longest(text)
    if found is None:
        return text, None, ""
    span, word = moment(found["phrase"], now), found["word"] or ""
    if word in ("since", "after", "from"):
        span, word = Span(span.start, now, span.words), "since"
    elif word in ("before", "until", "till", "by"):
        span, word = Span(span.start, span.start, span.words), "until"
    return _without(text, found), span, word


def _on(begin: float, stamp: float) -> float:
    """The time of day of a stamp on the day that begins at `begin`."""
    return begin + (stamp - _stamp(_midnight(datetime.fromtimestamp(stamp))))


def _longest(text: str) -> re.Match[str] | None:
    """The longest time in a text, the last of these."""
    return max(_FOUND.finditer(text), key=lambda found: (len(found[0]), found.start()), default=None)


def _without(text: str, found: re.Match[str]) -> str:
    return " ".join(f"{text[: found.start()]} {text[found.end() :]}".replace(" ,", ",").split()).strip(" ,")


def _span(name: str, text: str, now: float) -> Span:
    try:
        start, end = _READERS[name](text, datetime.fromtimestamp(now))
        return Span(_stamp(start), _stamp(end), text)
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f'no time: "{clean(text)}": {error}') from error


def _stamp(at: datetime) -> float:
    return at.timestamp()


Pair = tuple[datetime, datetime]


def _iso(text: str, now: datetime) -> Pair:
    bare = re.sub(r"^(at|on) ", "", text).upper().replace(" ", "T")
    at = datetime.fromisoformat(bare)
    if at.tzinfo is not None:
        at = at.astimezone().replace(tzinfo=None)
    return (at, at + timedelta(days=1)) if len(bare) == 10 else (at, at)


def _seconds(text: str, now: datetime) -> Pair:
    at = datetime.fromtimestamp(float(re.sub(r"[^\d.]", "", text)))
    return at, at


def _amount(text: str) -> timedelta:
    found = re.search(rf"(?:(?P<number>{_NUMBER}) )?(?P<unit>{_UNIT})(?: |$)", text)
    assert found is not None
    unit = next(seconds for name, seconds in UNITS.items() if name[0] == found["unit"][0] and (
        found["unit"][:2] == name[:2] or found["unit"] == "h"))  # fmt: skip
    return timedelta(seconds=_number(found["number"] or "one") * unit)


def _number(word: str) -> float:
    if word in ("a", "an"):
        return 1.0
    if word == "half an":
        return 0.5
    return float(NUMBERS.index(word)) if word in NUMBERS else float(word)


def _ago(text: str, now: datetime) -> Pair:
    at = now - _amount(text)
    return at, at


def _within(text: str, now: datetime) -> Pair:
    return now - _amount(re.sub(r"^\w+ the (last|past) ", "", text)), now


def _week(text: str, now: datetime) -> Pair:
    long = timedelta(days=30 if "month" in text else 7)
    if text.startswith("last"):
        return now - 2 * long, now - long
    return now - long, now


def _midnight(now: datetime) -> datetime:
    return now.replace(hour=0, minute=0, second=0, microsecond=0)


def _day(text: str, now: datetime) -> datetime:
    """Midnight at which the day in a text begins."""
    today = _midnight(now)
    if "before yesterday" in text:
        return today - timedelta(days=2)
    if "yesterday" in text:
        return today - timedelta(days=1)
    dated = re.search(_DATE, text)
    if dated:
        return datetime.fromisoformat(dated[0])
    named = next((index for index, name in enumerate(DAYS) if name in text), None)
    if named is None:
        return today
    back = (today.weekday() - named) % 7
    return today - timedelta(days=back or (7 if "last" in text else 0))


def _a_day(text: str, now: datetime) -> Pair:
    begin = _day(text, now)
    return begin, min(begin + timedelta(days=1), max(now, begin))


def _part_of(text: str) -> tuple[int, int]:
    found = re.search(_PART, text)
    assert found is not None
    return PARTS[found[0]]


def _day_part(text: str, now: datetime) -> Pair:
    low, high = _part_of(text)
    begin = _day(text, now)
    return begin + timedelta(hours=low), begin + timedelta(hours=high)


def _part(text: str, now: datetime) -> Pair:
    low, high = _part_of(text)
    begin = _midnight(now)
    if begin + timedelta(hours=low) > now and "this" not in text:
        begin -= timedelta(days=1)
    return begin + timedelta(hours=low), begin + timedelta(hours=high)


def _last_night(text: str, now: datetime) -> Pair:
    if text == "tonight":
        return _midnight(now) + timedelta(hours=18), _midnight(now) + timedelta(hours=30)
    evening = _midnight(now) - timedelta(days=1)
    return evening + timedelta(hours=18 if "evening" in text else 20), evening + timedelta(
        hours=24 if "evening" in text else 30
    )


def _hours(text: str) -> timedelta:
    """Since midnight, of a clock time in words."""
    if "noon" in text and "after" not in text:
        return timedelta(hours=12)
    if "midnight" in text:
        return timedelta(0)
    found = re.search(
        rf"(?P<shift>half past |quarter past |quarter to )?(?P<hour>{_HOUR})(?: ?(?P<half>[ap])\.?m)?", text
    )
    assert found is not None
    parts = found["hour"].split(":")
    hour = float(NUMBERS.index(parts[0])) if parts[0] in NUMBERS else float(parts[0])
    minutes = float(parts[1]) if len(parts) > 1 else 0.0
    seconds = float(parts[2]) if len(parts) > 2 else 0.0
    if hour > 24 or minutes >= 60 or seconds >= 60:
        raise InputError(f'no time: "{clean(text)}"')
    later = found["half"] == "p" or re.search(
        r"afternoon|evening|at night|\bnight|dinner|supper|teatime", text
    )
    if later and hour < 12:
        hour += 12
    if found["half"] == "a" and hour == 12:
        hour = 0.0
    shift = {"half past ": 30.0, "quarter past ": 15.0, "quarter to ": -15.0}.get(found["shift"] or "", 0.0)
    return timedelta(hours=hour, minutes=minutes + shift, seconds=seconds)


def _time(text: str, now: datetime) -> Pair:
    at = _midnight(now) + _hours(text)
    at = at if at <= now else at - timedelta(days=1)
    return at, at


def _timed_day(text: str, now: datetime) -> Pair:
    day = re.search(_DAY, text)
    assert day is not None
    at = _day(text, now) + _hours(re.sub(_DATE, "", text))
    return at, at


def _now(text: str, now: datetime) -> Pair:
    return now, now


_READERS = {
    "iso": _iso, "seconds": _seconds, "ago": _ago, "within": _within, "week": _week, "day_time": _timed_day,
    "time_day": _timed_day, "day_part": _day_part, "last_night": _last_night, "part": _part, "time": _time,
    "bare": _time, "day": _a_day, "now": _now,
}  # fmt: skip
