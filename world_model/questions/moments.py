"""Times in plain words: "yesterday morning", "at nine", "since breakfast", "two hours ago", ISO 8601.

Words count from `now`, the newest moment that is known; clock times are of the last 24 hours, in local time. A part of
the day stands for its hours; "since" counts from its beginning. What lies ahead ("tomorrow at nine") is for `ahead`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from estimation.errors import InputError
from world_model.questions.answers import clean, clock

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
TENS = {"twenty": 20, "thirty": 30, "forty": 40, "fifty": 50}
MONTHS = (  # noqa: SIM905
    "january february march april may june july august september october november december"
).split()
UNITS = {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0, "week": 604800.0, "month": 2592000.0}
JUST_NOW, HALF_DAY = 300.0, 43200.0  # s

_SPELLED = rf"(?:(?:{'|'.join(TENS)})(?:[- ](?:{'|'.join(NUMBERS[1:10])}))?|{'|'.join(reversed(NUMBERS))})"
_HALVES = {
    "half an": 0.5, "half a": 0.5, "a quarter of an": 0.25, "quarter of an": 0.25, "three quarters of an": 0.75,
    "one and a half": 1.5, "a couple of": 2.0, "a couple": 2.0, "couple of": 2.0, "a few": 3.0, "few": 3.0,
}  # fmt: skip
_NUMBER = rf"(?:\d+(?:\.\d+)?|{'|'.join(_HALVES)}|{_SPELLED}|an?)"
_UNIT = r"(?:sec(?:ond)?s?|min(?:ute)?s?|hours?|h|days?|weeks?|months?)"
_MONTH = rf"(?:{'|'.join(f'{name}|{name[:3]}' for name in MONTHS)}|sept)"
_NTH = r"\d{1,2}(?:st|nd|rd|th)?"
_CALENDAR = (
    rf"(?:(?:the )?{_NTH}(?: of)? {_MONTH}(?:,? \d{{4}})?|{_MONTH} (?:the )?{_NTH}(?:,? \d{{4}})?"
    r"|the \d{1,2}(?:st|nd|rd|th))"
)
_DATE = r"\d{4}-\d{2}-\d{2}"
_ISO = rf"{_DATE}(?:[t ]\d{{2}}:\d{{2}}(?::\d{{2}}(?:\.\d+)?)?(?:z|[+-]\d{{2}}:?\d{{2}})?)?"
_PART = rf"(?:(?:early |late )?(?:{'|'.join(sorted(PARTS, key=len, reverse=True))}))"
_DAY = (
    rf"(?:(?:earlier )?today|yesterday|the day before yesterday|(?:on |last |this |on last |this past )?"
    rf"(?:{'|'.join(DAYS)})|(?:on )?(?:{_DATE}|{_CALENDAR})|{_NUMBER} (?:days?|weeks?) (?:ago|before now))"
)
_HOUR = rf"(?:\d{{1,2}}(?::\d{{2}}){{0,2}}|{'|'.join(NUMBERS[1:13])})"
_TIME = (
    rf"(?:(?:(?:half past |(?:(?:a )?quarter|(?:\d{{1,2}}|{_SPELLED})(?: minutes)?) (?:past|to) )?{_HOUR}"
    r"(?: ?(?:am|pm|a\.m\.|p\.m\.)(?!\w)| o'?clock)?)|noon|midnight)"
    r"(?: (?:in the (?:morning|afternoon|evening)|at night))?"
)
_THAT_PART = rf"(?:this {_PART}|(?:late )?last night|last evening|yesterday {_PART})"
_WORD = r"(?:since|after|before|until|till|by|from)"
_BEFORE, _AFTER = r"(?:^|(?<=[\s,]))", r"(?=$|[\s,?.!])"


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
    def between(self) -> str:
        """ "between 2026-11-21 09:12 and 2026-11-21 10:00"."""
        return f"between {clock(self.start)} and {clock(self.end)}"


def moment(words: str | float, now: float) -> Span:
    """The moment or span that words stand for. Raises InputError where they stand for none, saying what can be said."""
    if isinstance(words, (int, float)) and not isinstance(words, bool):
        return Span(float(words), float(words), str(words))
    text = " ".join(str(words).lower().split())
    text = re.sub(rf"^{_WORD} ", "", text)
    for pattern, reader in _COMPILED:
        if pattern.fullmatch(text):
            return _span(reader, text, now)
    if re.fullmatch(_TIME, text):
        return _span(_time, f"at {text}", now)
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
        if last.end < first.start:  # "between noon and one", "from ten to six"
            more = HALF_DAY if last.end + HALF_DAY > first.start else 2 * HALF_DAY
            last = Span(last.start + more, last.end + more)
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


def _span(reader: Reader, text: str, now: float) -> Span:
    try:
        start, end = reader(text, datetime.fromtimestamp(now))
        return Span(_stamp(start), _stamp(end), text)
    except (ValueError, OverflowError, OSError) as error:
        raise InputError(f'no time: "{clean(text)}": {error}') from error


def _stamp(at: datetime) -> float:
    return at.timestamp()


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
    found = re.search(rf"(?:(?P<number>{_NUMBER}) )?(?P<unit>{_UNIT})(?P<half> and a half)?(?: |$)", text)
    assert found is not None
    unit = next(seconds for name, seconds in UNITS.items() if name[0] == found["unit"][0] and (
        found["unit"][:2] == name[:2] or found["unit"] == "h"))  # fmt: skip
    return timedelta(seconds=(_number(found["number"] or "one") + (0.5 if found["half"] else 0.0)) * unit)


def _number(word: str) -> float:
    if word in ("a", "an"):
        return 1.0
    if word in _HALVES:
        return _HALVES[word]
    parts = re.split("[- ]", word)
    if all(part in TENS or part in NUMBERS for part in parts):
        return float(sum(TENS.get(part) or NUMBERS.index(part) for part in parts))
    return float(word)


def _ago(text: str, now: datetime) -> Pair:
    at = now - _amount(text)
    return at, at


def _within(text: str, now: datetime) -> Pair:
    return now - _amount(re.sub(r"^.*?\b(last|past) ", "", text)), now


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
    back_by = re.search(rf"({_NUMBER}) (day|week)s? (?:ago|before now)", text)
    if back_by:
        return today - timedelta(days=round(_number(back_by[1]) * (7 if back_by[2] == "week" else 1)))
    calendar = re.search(_CALENDAR, text)
    if calendar:
        return _calendar(calendar[0], today)
    named = next((index for index, name in enumerate(DAYS) if name in text), None)
    if named is None:
        return today
    back = (today.weekday() - named) % 7
    return today - timedelta(days=back or (7 if "last" in text else 0))


def _calendar(text: str, today: datetime) -> datetime:
    """Of "5 november", "nov 5th 2026" or "the 5th" the newest that is not in the future, where no year is said."""
    named = re.search(_MONTH, text)
    year = re.search(r"\d{4}", text)
    day = int(re.sub(r"\D", "", re.sub(r"\d{4}", "", text)))
    month = next(k for k, name in enumerate(MONTHS, 1) if name[:3] == named[0][:3]) if named else today.month
    if year:
        return today.replace(year=int(year[0]), month=month, day=day)
    if named:
        at = today.replace(month=month, day=1).replace(day=day)
        return at if at <= today else at.replace(year=at.year - 1)
    if day <= today.day:
        return today.replace(day=day)
    return (today.replace(day=1) - timedelta(days=1)).replace(day=day)


def _a_day(text: str, now: datetime) -> Pair:
    begin = _day(text, now)
    return begin, min(begin + timedelta(days=1), max(now, begin))


def _part_of(text: str) -> tuple[int, int]:
    found = re.search(_PART, text)
    assert found is not None
    return PARTS[re.sub("^(early|late) ", "", found[0])]


def _part(text: str, now: datetime) -> Pair:
    """Of the day that is said, else the newest that has begun, or this one."""
    low, high = _part_of(text)
    begin = _day(text, now)
    if not re.search(_DAY, text) and begin + timedelta(hours=low) > now and "this" not in text:
        begin -= timedelta(days=1)
    return begin + timedelta(hours=low), begin + timedelta(hours=high)


def _last_night(text: str, now: datetime) -> Pair:
    tonight = text == "tonight"
    begin = _midnight(now) - timedelta(days=not tonight)
    low, high = (18, 24) if "evening" in text else (18 if tonight else 20, 30)
    return begin + timedelta(hours=low), begin + timedelta(hours=high)


def _hours(text: str) -> timedelta:
    """Since midnight, of a clock time in words."""
    if re.search(r"\bnoon\b", text):
        return timedelta(hours=12)
    if "midnight" in text:
        return timedelta(0)
    found = re.search(
        rf"(?:(?P<shift>half|(?:a )?quarter|(?:\d{{1,2}}|{_SPELLED})(?: minutes)?) (?P<way>past|to) )?"
        rf"(?P<hour>{_HOUR})(?: ?(?P<half>[ap])\.?m)?",
        text,
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
    return timedelta(hours=hour, minutes=minutes + _shift(found["shift"], found["way"]), seconds=seconds)


def _shift(words: str | None, way: str | None) -> float:
    """Minutes after the hour of "half past", "ten minutes to"."""
    if not words:
        return 0.0
    named = {"half": 30, "quarter": 15, "a quarter": 15}
    minutes = named[words] if words in named else _number(words.removesuffix(" minutes"))
    return -minutes if way == "to" else minutes


def _time(text: str, now: datetime) -> Pair:
    """Of the day that is said, else the newest that is past."""
    day = re.search(_DAY, text)
    at = _day(text, now) + _hours(text.replace(day[0], "") if day else text)
    at = at if day or at <= now else at - timedelta(days=1)
    return at, at


def _timed_part(text: str, now: datetime) -> Pair:
    """ "at eight last night": of the times with this hour the one within the part of a day."""
    found = re.search(_THAT_PART, text)
    assert found is not None
    words = found[0]
    reader = _last_night if "last" in words else _part
    low, high = reader(words, now)
    at = _midnight(low) + _hours(text.replace(words, ""))
    inside = [at + timedelta(hours=more) for more in (0, 12, 24) if low <= at + timedelta(hours=more) < high]
    return (inside[0], inside[0]) if inside else (at, at)


_PHRASES: tuple[tuple[str, Reader], ...] = (  # of two that begin alike the longer one first
    (rf"{_DAY},?(?: {_PART})? (?:at|around|about) {_TIME}", _time),
    (rf"{_THAT_PART},? (?:at|around|about) {_TIME}", _timed_part),
    (rf"(?:at|around|about) {_TIME},? {_THAT_PART}", _timed_part),
    (rf"(?:at |on )?{_ISO}", _iso),
    (r"(?:at )?\d{6,}(?:\.\d+)?(?: s)?", _seconds),
    (rf"{_NUMBER} (?:sec(?:ond)?s?|min(?:ute)?s?|h|hours?(?: and a half)?|months?) (?:ago|before now)", _ago),
    (rf"(?:(?:in|during|within|over|for) )?(?:the|these) (?:last|past) (?:{_NUMBER} )?{_UNIT}", _within),
    (r"(?:this|last|the previous) (?:week|month|year)|the week", _week),
    (r"(?:(?:on|at|over|during) the|this|last|over the last) weekend", _weekend),
    (
        r"just now|a moment ago|a (?:short|little) while ago",
        lambda text, now: (now - timedelta(seconds=JUST_NOW), now),
    ),
    (rf"(?:at|around|about) {_TIME},? {_DAY}(?: {_PART})?", _time),
    (rf"{_DAY} {_PART}", _part),
    (
        r"(?:last|to)night|last night|last evening|overnight|(?:during|in) the night|late last night",
        _last_night,
    ),
    (rf"(?:(?:(?:early |late )?(?:in the|this)|at|during|during the) )?{_PART}", _part),
    (rf"(?:at|around|about) {_TIME}", _time),
    (r"(?:\d{1,2}:\d{2}(?::\d{2})?|noon|midnight)", _time),
    (_DAY, _a_day),
    (r"(?:right )?now|at the moment|currently|at present", lambda text, now: (now, now)),
)
"""What stands for a time, and what reads it."""
_COMPILED = tuple((re.compile(pattern), reader) for pattern, reader in _PHRASES)
_ANY = "|".join(f"(?:{pattern})" for pattern, _ in _PHRASES)
_RANGE = re.compile(
    rf"{_BEFORE}(?:between|from) (?P<a>{_ANY}|{_TIME}) (?:and|to|until|till) (?P<b>{_ANY}|{_TIME}){_AFTER}"
)
_FOUND = re.compile(rf"{_BEFORE}(?:(?P<word>{_WORD}) )?(?P<phrase>{_ANY}){_AFTER}")
_SINCE_TIME = re.compile(rf"{_BEFORE}(?P<word>since|after|before|until|till|by) (?P<phrase>{_TIME}){_AFTER}")


# The time ahead, of questions about the future only.

_DAY_AHEAD = rf"(?:the day after tomorrow|tomorrow|today|tonight|(?:on |next |this )?(?:{'|'.join(DAYS)}))"
_AT = rf"(?:at|around|about|by) {_TIME}"
_AHEAD = re.compile(
    rf"{_BEFORE}(?:(?:in|within) (?P<after>{_NUMBER} {_UNIT})|(?P<later>{_NUMBER} {_UNIT}) from now"
    rf"|(?P<day>{_DAY_AHEAD}),?(?: (?P<at>{_AT})| (?:in the )?(?P<part>{_PART}))?"
    rf"|(?P<early>{_AT})(?:,? (?P<then>{_DAY_AHEAD}))?|(?:this|in the) (?P<soon>{_PART})){_AFTER}"
)


def ahead(text: str, now: float) -> tuple[str, Span | None]:
    """A question about the future without its time, and the time; lower-case text, single spaces."""
    found = max(_AHEAD.finditer(text), key=lambda each: len(each[0]), default=None)
    if found is None:
        return text, None
    today = datetime.fromtimestamp(now)
    start, end = _coming(found, today)
    return _without(text, found), Span(_stamp(start), _stamp(end), found[0])


def _coming(found: re.Match[str], now: datetime) -> Pair:
    amount = found["after"] or found["later"]
    if amount:
        return now + _amount(amount), now + _amount(amount)
    day, clock_time, part = found["day"] or found["then"], found["at"] or found["early"], found["part"]
    begin = _midnight(now) + timedelta(days=_days_ahead(day or "", now))
    if clock_time:
        at = begin + _hours(f"{clock_time} {'at night' if day == 'tonight' else ''}")
        at = at if at > now or day else at + timedelta(days=1)
        return at, at
    part = part or found["soon"] or ("evening" if day == "tonight" else "")
    low, high = _part_of(part) if part else (0, 24)
    if found["soon"] and begin + timedelta(hours=high) <= now:
        begin += timedelta(days=1)
    return max(begin + timedelta(hours=low), now), begin + timedelta(hours=high)


def _days_ahead(day: str, now: datetime) -> int:
    if "after tomorrow" in day:
        return 2
    if "tomorrow" in day:
        return 1
    named = next((index for index, name in enumerate(DAYS) if name in day), None)
    return 0 if named is None else (named - now.weekday()) % 7 or 7
