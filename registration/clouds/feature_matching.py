"""KISS-Matcher in a process of its own.

Version 1.0.2 ends the process where a cloud yields no feature, and its threads write to one bit vector and one hash
map at once: that too may end the process, and makes its answers vary. So it runs beside us, on one thread, and where
it dies the answer is None.
"""

import atexit
import importlib.util
import os
import signal
import struct
import subprocess
import sys
import threading
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

REQUEST = struct.Struct("<qqd")
ANSWER = struct.Struct("<q12d")


@dataclass(frozen=True)
class FeatureMatch:
    """What features say: `transform` (4, 4) from the source's to the target's frame, and how many agree with it."""

    transform: NDArray[np.float64]
    inliers: int


class _Matcher:
    """The process that matches, started when first asked and again where it died or belongs to a parent of ours."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, request: bytes) -> bytes:
        """The answer, or no bytes where the process died of the question."""
        with self._lock:
            process = self._running()
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(request)
                process.stdin.flush()
                answer = process.stdout.read(ANSWER.size)
            except BrokenPipeError:
                answer = b""
            if len(answer) < ANSWER.size:
                self._end()
                return b""
            return answer

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self._owner = os.getpid()
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            with process:
                pass

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._end()


_matcher = _Matcher()
atexit.register(_matcher.close)


def match_features(source: NDArray[Any], target: NDArray[Any], voxel: float) -> FeatureMatch | None:
    """The motion that lays the features of cloud `source` (N, 3) on those of `target` (M, 3), from anywhere.

    voxel : metres, of the grid both are thinned by. None where there is no answer, and where the library, which is
    optional, is not installed.
    """
    if importlib.util.find_spec("kiss_matcher") is None:
        return None
    clouds = [np.ascontiguousarray(cloud, dtype="<f4") for cloud in (source, target)]
    request = REQUEST.pack(len(source), len(target), voxel) + b"".join(cloud.tobytes() for cloud in clouds)
    answer = _matcher.ask(request)
    if not answer:
        return None
    inliers, *entries = ANSWER.unpack(answer)
    transform = np.eye(4)
    transform[:3] = np.reshape(entries, (3, 4))
    return FeatureMatch(transform, inliers) if np.isfinite(transform).all() else None


def _alone() -> Any:
    """The library, with one thread: it counts the cores it may use once, at its first question."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if cores:
        os.sched_setaffinity(0, {min(cores)})
    import kiss_matcher

    corner = np.random.default_rng(0).uniform(0.0, 1.0, (200, 3)).astype(np.float32)
    kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size=0.1)).estimate(corner, corner)
    if cores:
        os.sched_setaffinity(0, cores)
    return kiss_matcher


def _serve(questions: IO[bytes], answers: IO[bytes]) -> None:
    library = _alone()
    while header := questions.read(REQUEST.size):
        n, m, voxel = REQUEST.unpack(header)
        source, target = (np.frombuffer(questions.read(12 * count), "<f4").reshape(-1, 3) for count in (n, m))
        matcher = library.KISSMatcher(library.KISSMatcherConfig(voxel_size=voxel))
        solution = matcher.estimate(source, target)
        motion = np.c_[solution.rotation, np.asarray(solution.translation).ravel()]
        answers.write(ANSWER.pack(matcher.get_num_final_inliers(), *motion.ravel()))
        answers.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What the library prints is for its authors.
    channel = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _serve(sys.stdin.buffer, os.fdopen(channel, "wb"))
