"""A survey of a recording of any readable format."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from whereabouts.logs import RawMessage, convert_log, open_raw
from whereabouts.logs.format_detection import detect
from whereabouts.messages.compressed_depth import SUFFIXES, encoding_of
from whereabouts.messages.decode import RECORDS, UnusableMessageError, scans, seconds
from whereabouts.messages.records import TransformRecord, strip_slash
from whereabouts.messages.type_names import COMPRESSED, IMAGE, ODOMETRY, SCAN, TF
from whereabouts.robot.survey import SeenTopic, Survey
from whereabouts.system.log_errors import UnreadableTypeError

# What a recording holds shows within its first minute, but for transforms that are latched later.
LOOK_AT_SECONDS = 60.0
LEAST_MESSAGES = 3000
# Messages of a kind that no record is made of, such as pictures, are large: a few tell frame and clock.
FEW = 5


def survey_bag(path: Path, look_at: float = LOOK_AT_SECONDS) -> Survey:
    """Look into the first `look_at` seconds of a recording; a log without topics is made a bag of first.

    Raises LogError: it cannot be read.
    """
    if detect(path)[0] in ("carmen", "g2o"):
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "log.mcap"
            made = convert_log(path, bag, seconds=look_at)
            survey = survey_bag(bag, look_at)
        survey.source, survey.left_out = str(path), made.summary.lines()
        return survey
    survey = Survey(str(path))
    with open_raw(path) as raw:
        for topic in raw.topics:
            survey.topics[topic.name] = SeenTopic(topic.name, topic.type_name, qos=topic.qos)
        first: int | None = None
        for count, message in enumerate(raw):
            first = message.log_time if first is None else first
            survey.seconds = (message.log_time - first) / 1e9
            if survey.seconds > look_at and count > LEAST_MESSAGES:
                break
            _look(survey, message)
        survey.left_out = raw.summary.lines()
    return survey


def _look(survey: Survey, message: RawMessage) -> None:
    topic = message.topic
    seen = survey.topics.setdefault(topic.name, SeenTopic(topic.name, topic.type_name, qos=topic.qos))
    if topic.type_name not in RECORDS and seen.count >= FEW:
        return
    try:
        look_at_message(survey, seen, message.decoded(), message.log_time / 1e9)
    except UnreadableTypeError:
        return


def look_at_message(survey: Survey, seen: SeenTopic, message: Any, received: float) -> None:
    """One message of a topic, from a bag or live. received : when, s."""
    try:
        _understand(survey, seen, message, received)
    except UnusableMessageError as error:
        seen.refused[str(error)] += 1
        seen.empty += seen.kind == SCAN


def _understand(survey: Survey, seen: SeenTopic, message: Any, received: float) -> None:
    if seen.kind == TF:
        for record in RECORDS[TF](message, seen.name):
            assert isinstance(record, TransformRecord)
            survey.add_transform(
                record.frame_id, record.child_frame_id, record.transform, record.stamp, seen.name
            )
            if not record.static:
                seen.note(record.stamp, record.frame_id, received)
        return
    header = getattr(message, "header", None)
    if header is None:
        return
    seen.note(seconds(header.stamp), header.frame_id, received)
    if seen.kind == SCAN:
        seen.range_max = float(message.range_max)
        seen.empty += not any(record.scan.valid.any() for record in scans(message, seen.name))
    elif seen.kind == ODOMETRY:
        seen.child = strip_slash(message.child_frame_id)
    elif seen.kind == IMAGE:
        seen.encoding = message.encoding
    elif seen.kind == COMPRESSED and seen.name.endswith(SUFFIXES):
        seen.encoding = encoding_of(message)
