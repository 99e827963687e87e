"""Times in plain words: "yesterday morning", "at nine", "since breakfast", "two hours ago", ISO 8601.

A time is a day, a part of the day and a clock time, each at most once and in any order, or one of some fixed phrases.
Words count from `now`, the newest moment that is known, backwards, for `ahead` forwards; all are in local time. A part
of the day stands for its hours; "since" counts from its beginning.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from numbers import Real

from estimation.checks import as_stamp
from estimation.errors import InputError
from world_model.questions.answers import clean, clock

PARTS = {
    "morning": (6, 12), "breakfast": (7, 9), "breakfast time": (7, 9), "lunch": (12, 14), "lunchtime": (12, 14),
    "lunch time": (12, 14), "afternoon": (12, 18), "teatime": (16, 17), "dinner": (18, 20), "supper": (18, 20),
    "evening": (18, 24), "night": (22, 30), "overnight": (20, 30), "tonight": (18, 24),
}  # fmt: skip
"""Hours of the day; after 24 those of the next."""
DAYS = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
NUMBERS = (  # noqa: SIM905
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen "
    "seventeen eighteen nineteen twenty"
).split()
TENS = {"twenty": 20, "thirty": 30, "forty": 40, "fifty": 50}
MONTHS = (  # noqa: SIM905
    "january february march april may june july august september october november december"
).split()
UNITS = {
    "second": 1.0, "minute": 60.0, "hour": 3600.0, "h": 3600.0, "day": 86400.0, "week": 604800.0, "month": 2592000.0,
    "year": 31536000.0,
}  # fmt: skip
JUST_NOW, HALF_DAY = 300.0, 43200.0  # s
AROUND = 1800.0  # s before and after a moment that comes every day
DAYTIME = 6.0  # h: an hour that is only counted to twelve is not meant before it

_SPELLED = rf"(?:(?:{'|'.join(TENS)})(?:[- ](?:{'|'.join(NUMBERS[1:10])}))?|{'|'.join(reversed(NUMBERS))})"
_HALVES = {
    "half an": 0.5, "half a": 0.5, "a quarter of an": 0.25, "quarter of an": 0.25, "three quarters of an": 0.75,
    "one and a half": 1.5, "a couple of": 2.0, "a couple": 2.0, "couple of": 2.0, "a few": 3.0, "few": 3.0,
}  # fmt: skip
_NUMBER = rf"(?:\d+(?:\.\d+)?|{'|'.join(_HALVES)}|{_SPELLED}|an?)"
_UNIT = r"(?:sec(?:ond)?s?|min(?:ute)?s?|hours?|h|days?|weeks?|months?|years?)"
_AMOUNT = rf"(?:{_NUMBER} {_UNIT}(?: and a half)?)"
_MONTH = rf"(?:{'|'.join(f'{name}|{name[:3]}' for name in MONTHS)}|sept)"
_NTH = r"\d{1,2}(?:st|nd|rd|th)?"
_CALENDAR = (
    rf"(?:(?:the )?{_NTH}(?: of)? {_MONTH}(?:,? \d{{4}})?|{_MONTH} (?:the )?{_NTH}(?:,? \d{{4}})?"
    r"|the \d{1,2}(?:st|nd|rd|th)|\d{1,2}\.\d{1,2}\.(?:\d{4})?)"
)
_DATE = r"\d{4}-\d{2}-\d{2}"
_ISO = rf"{_DATE}(?:[t ]\d{{2}}:\d{{2}}(?::\d{{2}}(?:\.\d+)?)?(?:z|[+-]\d{{2}}:?\d{{2}})?)"
_PART = (
    r"(?:(?:(?:in|during|at) )?(?:the )?(?:early |late |first thing |first thing in the )?"
    rf"(?:{'|'.join(sorted(PARTS, key=len, reverse=True))}))"
)
_WEEKDAY = (
    rf"(?:(?:on )?(?:last |this |past |this past |next )?(?:{'|'.join(DAYS)})"
    r"|(?:on|last) (?:mon|tues?|wed|thu(?:rs?)?|fri|sat|sun))"
)
_DAY = (
    rf"(?:(?:earlier )?today|yesterday|the day before yesterday|(?:the day after )?tomorrow|{_WEEKDAY}"
    rf"|(?:on )?(?:{_DATE}|{_CALENDAR})|{_NUMBER} (?:days?|weeks?) (?:ago|before now))"
)
_HOUR = rf"(?:\d{{1,2}}(?:[:.]\d{{2}}(?::\d{{2}})?)?|{'|'.join(NUMBERS[1:13])})"
_SHIFT = rf"(?:half(?: past)?|(?:(?:a )?quarter|(?:\d{{1,2}}|{_SPELLED})(?: minutes)?) (?:past|to))"
_TIME = rf"(?:(?:{_SHIFT} )?{_HOUR}(?: ?(?:am|pm|a\.m\.?|p\.m\.?)(?!\w)| o'?clock)?|noon|midday|midnight)"
"""A clock time; a bare number is one only behind a word that says so."""
_SURE_TIME = (
    rf"(?:\d{{1,2}}:\d{{2}}(?::\d{{2}})?|(?:{_SHIFT} )?{_HOUR} ?(?:am|pm|a\.m\.?|p\.m\.?|o'?clock)(?!\w)"
    rf"|{_SHIFT} {_HOUR}|noon|midday|midnight)"
)
_CLOCK = rf"(?:(?:at|around|about|at about|at around) {_TIME}|{_SURE_TIME})"
_ATOM = rf"(?:{_DAY}|{_PART}|{_CLOCK})"
_WHEN = rf"{_ATOM}(?:,? {_ATOM}){{0,2}}"
_WORD = r"(?:since|after|before|until|till|by|from)"
_BEFORE, _AFTER = r"(?:^|(?<=[\s,]))", r"(?=$|[\s,?.!])"
_SAID_AS = (
    (r"\b(?:late )?last night\b|\b(?:during|in|over) the night\b|(?<!yesterday )\bovernight\b", "yesterday overnight"),
    (r"\bthe night before last\b", "2 days ago overnight"),
    (r"\blast evening\b", "yesterday evening"),
    (r"(?<!today )\btonight\b", "today tonight"),
    (rf"\b(?:earlier |first thing |early |late )?this ({_PART})\b", r"today \1"),
    (r"\bthe day before yesterday\b", "2 days ago"),
    (r"\ba fortnight ago\b", "2 weeks ago"),
)  # fmt: skip
"""What is put into a day and a part of it."""


Pair = tuple[datetime, datetime]
Reader = Callable[[str, datetime], Pair]


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

    @property
    def lasts(self) -> bool:
        """Whether it is more than a moment."""
        return self.end - self.start >= 1.0

    @property
    def between(self) -> str:
        """ "between 2026-11-21 09:12 and 2026-11-21 10:00"."""
        return f"between {clock(self.start)} and {clock(self.end)}"


When = str | float | Span | None
"""A time in words, in s, as a span, or none."""


def moment(words: str | float, now: float) -> Span:
    """The moment or span that words stand for. Raises InputError where they stand for none, saying what can be said."""
    if isinstance(words, Real) and not isinstance(words, bool):
        stamp = as_stamp("time", words)
        return Span(stamp, stamp, str(words))
    text = re.sub(rf"^{_WORD} ", "", _rewritten(" ".join(str(words).lower().split()), now))
    for pattern, reader in (*_PHRASES, (_BARE, _when)):
        if _compiled(pattern).fullmatch(text):
            return _span(reader, text, now)
    raise InputError(
        f'no time: "{clean(str(words))}"; say "yesterday morning", "at nine", "two hours ago", "since breakfast", '
        '"monday at 14:30" or 2026-11-21T09:00'
    )


def extract(text: str, now: float) -> tuple[str, Span | None, str]:
    """A question without its time, the time, and the word before it ("since"); lower-case text, single spaces."""
    text = _rewritten(text, now)
    found = _compiled(_RANGE).search(text)
    if found:
        rest = _without(text, found)
        first, last = found["a"], found["b"]
        more = re.search(rf"{_BEFORE}{_DAY}(?:,? {_PART})?{_AFTER}", rest)
        if more and not re.search(_DAY, f"{first} {last}"):
            rest, first, last = _without(rest, more), f"{first} {more[0]}", f"{last} {more[0]}"
        return rest, _between(first, last, found[0], now), "between"
    # The longest time, the last of these; a bare number behind "since" is one where no other is as long.
    found = max(_compiled(_FOUND).finditer(text), key=lambda each: (len(each[0]), each.start()), default=None)
    if found is None:
        return text, None, ""
    phrase, word = found["phrase"] or found["bare"], found["word"] or found["bare_word"] or ""
    span = moment(phrase, now)
    if word == "after":  # "after lunch yesterday" is of that day
        day = re.search(_DAY, phrase) and re.search(f"{_PART}|{_CLOCK}", phrase)
        midnight = (_midnight(datetime.fromtimestamp(span.start)) + timedelta(days=1)).timestamp()
        span, word = Span(min(span.end, now), min(midnight, now) if day else now, span.words), "since"
    elif word in ("since", "from"):
        span, word = Span(span.start, now, span.words), "since"
    elif word in ("before", "until", "till", "by"):
        span, word = Span(span.start, span.start, span.words), "until"
    return _without(text, found), span, word


def recurring(span: Span, now: float, past: float) -> list[tuple[float, float]]:
    """A time of day, a weekday or both on each day of the last `past` s, from and to in s; [] of what comes once.

    A moment stands for the hour around it.
    """
    weekday = rf"(?:on )?(?:{'|'.join(DAYS)})|(?:on|at) the weekend"
    atom = rf"(?:{_PART}|{_CLOCK}|{weekday})"
    between = rf"(?:between|from) (?:at )?{_TIME} (?:and|to|until|till) (?:at )?{_TIME}"
    if not re.fullmatch(rf"{atom}(?:,? {atom}){{0,2}}|{between}", span.words):
        return []
    step = 7 if re.search(weekday, span.words) else 1
    day = datetime.fromtimestamp(span.start)
    long = span.end - span.start
    if not re.search(rf"{_PART}|{_TIME}", span.words):
        long = timedelta(days=1 + ("weekend" in span.words)).total_seconds()
    early = 0.0 if span.lasts else AROUND
    begun = ((day - timedelta(days=k)).timestamp() - early for k in range(0, 1 + int(past / 86400.0), step))
    spans = ((max(start, now - past), min(start + long + 2.0 * early, now)) for start in begun)
    return [(start, end) for start, end in spans if end > start]


def ahead(text: str, now: float) -> tuple[str, Span | None]:
    """A question about the future without its time, and the time; lower-case text, single spaces."""
    text = _rewritten(text, now)
    found = max(_compiled(_AHEAD).finditer(text), key=lambda each: len(each[0]), default=None)
    if found is None:
        return text, None
    amount = found["after"] or found["later"]
    span = Span(now + _seconds_of(amount), now + _seconds_of(amount)) if amount else None
    return _without(text, found), span or _span(lambda text, at: _when(text, at, True), found["phrase"], now)


def _rewritten(text: str, now: float) -> str:
    if "same time" in text or "this time" in text:
        text = re.sub(r"\bat (?:about )?(?:this|the same) time\b", f"at {clock(now)[11:]}", text)
    for pattern, other in _SAID_AS:
        text = re.sub(pattern, other, text)
    return text


def _between(first: str, last: str, words: str, now: float) -> Span:
    """From a time to another; what only one of them says of day, part of the day and am or pm, it says of both."""
    half = re.search(r"(?<=\d) ?[ap]\.?m\b|(?<=[a-z]) [ap]\.?m\b", last)
    bare = re.fullmatch(rf"(?:at )?{_TIME}", first)
    if half and bare and not re.search(r"[ap]\.?m\b", first):
        early, late = (
            datetime.fromtimestamp(moment(text, now).start).time() for text in (f"{first}{half[0]}", last)
        )
        first += half[0] if early <= late else ""
    for atom in (_PART, _DAY):
        one, other = re.search(atom, first), re.search(atom, last)
        if other and not one and bare:
            first += f" {other[0]}"
        elif one and not other and atom == _DAY and re.search(_CLOCK, f"at {last}"):
            last += f" {one[0]}"
    start, end = moment(first, now).start, moment(last, now).end
    while end < start:  # "between noon and one", "from ten to six"
        end += HALF_DAY
    return Span(start, end, words)


def _without(text: str, found: re.Match[str]) -> str:
    return " ".join(f"{text[: found.start()]} {text[found.end() :]}".replace(" ,", ",").split()).strip(" ,")


def _span(reader: Reader, text: str, now: float) -> Span:
    try:
        start, end = reader(text, datetime.fromtimestamp(now))
        return Span(start.timestamp(), end.timestamp(), text)
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f'no time: "{clean(text)}": {error}') from error


def _at(stamp: float) -> Pair:
    """A moment, s; hours are counted back in s, also across a change of the clocks."""
    at = datetime.fromtimestamp(stamp)
    return at, at


def _lately(seconds: float, now: datetime) -> Pair:
    return _at(now.timestamp() - seconds)[0], now


def _iso(text: str, now: datetime) -> Pair:
    at = datetime.fromisoformat(re.sub(r"^(at|on) ", "", text).upper().replace(" ", "T"))
    if at.tzinfo is not None:
        at = at.astimezone().replace(tzinfo=None)
    return at, at


def _seconds_of(text: str) -> float:
    """s, of an amount such as "two hours" or "hour and a half"."""
    found = re.search(rf"(?:(?P<number>{_NUMBER}) )?(?P<unit>{_UNIT})(?P<half> and a half)?(?: |$)", text)
    assert found is not None
    unit = next(seconds for name, seconds in UNITS.items() if name.startswith(found["unit"][:2]))
    return (_number(found["number"] or "one") + (0.5 if found["half"] else 0.0)) * unit


def _number(word: str) -> float:
    if word in ("a", "an"):
        return 1.0
    if word in _HALVES:
        return _HALVES[word]
    parts = re.split("[- ]", word)
    if all(part in TENS or part in NUMBERS for part in parts):
        return float(sum(TENS.get(part) or NUMBERS.index(part) for part in parts))
    return float(word)


def _week(text: str, now: datetime) -> Pair:
    """The week from monday on, the month or year of the calendar, or the one before."""
    begin = _midnight(now)
    if "year" in text:
        begin = begin.replace(month=1, day=1)
        before = begin.replace(year=begin.year - 1)
    elif "month" in text:
        begin = begin.replace(day=1)
        before = (begin - timedelta(days=1)).replace(day=1)
    else:
        begin -= timedelta(days=now.weekday())
        before = begin - timedelta(days=7)
    return (before, begin) if text.startswith(("last", "the previous")) else (begin, now)


def _weekend(text: str, now: datetime) -> Pair:
    """The newest saturday and sunday; on these days "last" is the weekend before."""
    begin = _midnight(now) - timedelta(days=(now.weekday() - 5) % 7)
    if "last" in text and now.weekday() >= 5:
        begin -= timedelta(days=7)
    return begin, min(begin + timedelta(days=2), now)


def _midnight(now: datetime) -> datetime:
    return now.replace(hour=0, minute=0, second=0, microsecond=0)


def _day(text: str, now: datetime, coming: bool) -> datetime:
    """Midnight at which the day in a text begins. coming : a weekday is the next one."""
    today = _midnight(now)
    for word, days in (("after tomorrow", 2), ("tomorrow", 1), ("yesterday", -1), ("today", 0)):
        if word in text:
            return today + timedelta(days=days)
    dated = re.search(_DATE, text)
    if dated:
        return datetime.fromisoformat(dated[0])
    back_by = re.search(rf"({_NUMBER}) (day|week)s? (?:ago|before now)", text)
    if back_by:
        return today - timedelta(days=round(_number(back_by[1]) * (7 if back_by[2] == "week" else 1)))
    calendar = re.search(_CALENDAR, text)
    if calendar:
        return _calendar(calendar[0], today)
    named = next(index for index, name in enumerate(DAYS) if re.search(rf"\b{name[:3]}", text))
    if coming or "next" in text:
        return today + timedelta(days=(named - today.weekday()) % 7 or 7)
    return today - timedelta(days=(today.weekday() - named) % 7 or (7 if "last" in text else 0))


def _calendar(text: str, today: datetime) -> datetime:
    """Of "5 november", "nov 5th 2026", "5.11." or "the 5th" the newest that is not ahead, where no year is said."""
    named, year = re.search(_MONTH, text), re.search(r"\d{4}", text)
    day, *after = (int(number) for number in re.findall(r"\d+", re.sub(r"\d{4}", "", text)))
    month = after[0] if after else today.month
    if named:
        month = next(k for k, name in enumerate(MONTHS, 1) if name[:3] == named[0][:3])
    if year:
        return today.replace(year=int(year[0]), month=month, day=day)
    if named or after:
        at = today.replace(month=month, day=1).replace(day=day)
        return at if at <= today else at.replace(year=at.year - 1)
    if day <= today.day:
        return today.replace(day=day)
    return (today.replace(day=1) - timedelta(days=1)).replace(day=day)


def _hours(text: str) -> tuple[float, bool]:
    """h since midnight of a clock time in words, and whether that is sure: else it is counted to twelve."""
    if text.endswith(("noon", "midday", "midnight")):
        return (0.0 if "midnight" in text else 12.0), True
    found = re.search(
        rf"(?:(?P<shift>{_SHIFT}) )?(?P<hour>{_HOUR})(?: ?(?P<half>[ap])\.?m)?(?: o'?clock)?\.?$", text
    )
    assert found is not None
    parts = re.split("[:.]", found["hour"])
    hour = float(NUMBERS.index(parts[0])) if parts[0] in NUMBERS else float(parts[0])
    minutes, seconds = (float(parts[k]) if len(parts) > k else 0.0 for k in (1, 2))
    if hour > 24 or minutes >= 60 or seconds >= 60:
        raise ValueError("there are 24 hours of 60 minutes")
    if found["half"]:
        hour = hour % 12 + (12 if found["half"] == "p" else 0)
    shift = (found["shift"] or "").removeprefix("a ").replace(" minutes", "")
    if shift.startswith("half"):
        minutes += 30.0
    elif shift:
        many, way = shift.rsplit(" ", 1)
        minutes += (15.0 if many == "quarter" else _number(many)) * (-1 if way == "to" else 1)
    return hour + minutes / 60 + seconds / 3600, bool(found["half"]) or len(parts) > 1 or not 0 < hour < 12


def _when(text: str, now: datetime, coming: bool = False) -> Pair:
    """A day, a part of it, a clock time: what is not said is the newest that has begun, coming : the next."""
    found: dict[str, str] = {}
    for name, pattern in (("day", _DAY), ("part", _PART), ("clock", _TIME)):
        match = re.search(rf"{_BEFORE}{pattern}{_AFTER}", text)
        found[name] = match[0] if match else ""
        text = _without(text, match) if match else text
    day = bool(found["day"])
    begin = _day(found["day"], now, coming) if day else _midnight(now)
    part = found["part"]
    low, high = next(
        (PARTS[name] for name in sorted(PARTS, key=len, reverse=True) if part.endswith(name)), (0, 24)
    )
    if found["clock"]:
        hours, sure = _hours(found["clock"])
        inside = [hours + more for more in (0, 12, 24) if part and low <= hours + more < high]
        if inside or sure:
            at = _rolled(begin, (inside or [hours])[0], now, day, coming)
        elif day or coming:
            at = _rolled(begin, hours + (12 if hours < DAYTIME else 0), now, day, coming)
        else:
            both = [_rolled(begin, each, now, day, coming) for each in (hours, hours + 12)]
            at = max(both, key=lambda each: (each.hour >= DAYTIME, each))
        return at, at
    start, end = begin + timedelta(hours=low), begin + timedelta(hours=high)
    if not day and not coming and start > now:
        start, end = start - timedelta(days=1), end - timedelta(days=1)
    if coming:
        more = timedelta(days=not day and end <= now)
        return max(start + more, now if start.date() == now.date() else start), end + more
    return start, end if part else min(end, max(now, start))


def _rolled(begin: datetime, hours: float, now: datetime, day: bool, coming: bool) -> datetime:
    """A time of a day; where none is said, of the newest on which it is past, or the next on which it is not."""
    at = begin + timedelta(seconds=round(hours * 3600))
    if day or (at > now) == coming:
        return at
    return at + timedelta(days=1 if coming else -1)


_PHRASES: tuple[tuple[str, Reader], ...] = (  # of two that begin alike the longer one first
    (rf"(?:at |on )?{_ISO}", _iso),
    (r"(?:at )?\d{6,}(?:\.\d+)?(?: s)?", lambda text, now: _at(float(re.sub(r"[^\d.]", "", text)))),
    (_WHEN, _when),
    (rf"{_AMOUNT} (?:ago|before now|earlier)", lambda text, now: _at(now.timestamp() - _seconds_of(text))),
    (
        rf"(?:(?:in|during|within|over|for) )?(?:the|these) (?:last|past) (?:{_NUMBER} )?{_UNIT}",
        lambda text, now: _lately(_seconds_of(re.sub(r"^.*?\b(last|past) ", "", text)), now),
    ),
    (rf"for {_AMOUNT}", lambda text, now: _lately(_seconds_of(text), now)),
    (r"(?:this|last|the previous) (?:week|month|year)|the week", _week),
    (r"(?:(?:(?:on|at|over|during) )?the|this|(?:over )?(?:the )?last) weekend", _weekend),
    (r"just now|a moment ago|a (?:short|little) while ago", lambda text, now: _lately(JUST_NOW, now)),
    (r"(?:right )?now|at the moment|currently|at present", lambda text, now: (now, now)),
)
"""What stands for a time, and what reads it."""
_BARE = rf"{_TIME}(?:,? {_ATOM}){{0,2}}"
_ANY = "|".join(f"(?:{pattern})" for pattern, _ in _PHRASES)
_RANGE = (
    rf"{_BEFORE}(?:between|from) (?P<a>{_ANY}|{_BARE}) (?:and|to|until|till) (?P<b>{_ANY}|{_BARE}){_AFTER}"
)
_FOUND = (
    rf"{_BEFORE}(?:(?:(?P<word>{_WORD}) )?(?P<phrase>{_ANY})"
    rf"|(?P<bare_word>since|after|before|until|till|by) (?P<bare>{_BARE})){_AFTER}"
)
_AHEAD = (
    rf"{_BEFORE}(?:(?:in|within) (?P<after>{_AMOUNT})|(?P<later>{_AMOUNT}) from now"
    rf"|(?:(?:by|until) )?(?P<phrase>{_WHEN}|(?<=by ){_BARE})){_AFTER}"
)


@cache
def _compiled(pattern: str) -> re.Pattern[str]:
    """These are long: compiled with the first question, not wherever the module is imported."""
    return re.compile(pattern)
