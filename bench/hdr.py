"""HDR histograms in the file formats that HdrHistogram's tools read.

A histogram of whole numbers counts them in buckets whose width grows with the value, so that each
is known to a given number of decimal digits over the whole range. Two files are written: the
percentile table (``.hgrm``, for the plotter) and the histogram log (``.hlog``), whose lines hold
whole histograms in the V2 compressed encoding, each under a tag. Format: HdrHistogram's sources,
``AbstractHistogram.encodeIntoByteBuffer``, ``ZigZagEncoding``, ``HistogramLogWriter``.
"""

import base64
import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

DIGITS = 3
"""Significant decimal digits of a value."""
_COOKIE, _COMPRESSED = 0x1C849303 | 0x10, 0x1C849304 | 0x10
_HALF_MAGNITUDE = int(np.ceil(np.log2(2 * 10**DIGITS))) - 1
_HALF = 1 << _HALF_MAGNITUDE
"""Buckets in which the width stays the same."""
_TICKS = 5
"""Lines of the percentile table each time that the distance to 100 % halves."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Counts of values, and what the buckets cannot tell exactly."""

    counts: NDArray[np.int64]
    """By bucket, up to the last that is not empty."""
    mean: float
    deviation: float
    largest: int

    @classmethod
    def of(cls, values: ArrayLike) -> "Histogram":
        """Count whole numbers that are not negative.

        Raises:
            ValueError: there are none, or one is negative.
        """
        found = np.asarray(values, dtype=np.int64).ravel()
        if not found.size or found.min() < 0:
            raise ValueError("a histogram needs values, none of them negative")
        counts = np.bincount(_bucket(found)).astype(np.int64)
        return cls(counts, float(found.mean()), float(found.std()), int(found.max()))

    @property
    def total(self) -> int:
        """How many values were counted."""
        return int(self.counts.sum())

    def encode(self) -> str:
        """Return it as text: V2 encoding, compressed, base 64."""
        body = _zigzag_runs(self.counts)
        highest = max(2, self.largest)
        head = struct.pack(">iiiiqqd", _COOKIE, len(body), 0, DIGITS, 1, highest, 1.0)
        packed = zlib.compress(head + body)
        return base64.b64encode(struct.pack(">ii", _COMPRESSED, len(packed)) + packed).decode()

    def percentile_table(self) -> str:
        """Return the table of ``.hgrm``: value, percentile, count up to it, 1/(1-percentile)."""
        lines = ["       Value     Percentile TotalCount 1/(1-Percentile)", ""]
        filled = np.flatnonzero(self.counts)
        upto = np.cumsum(self.counts[filled])
        tops = _highest(filled)
        for level in _levels(self.total):
            i = int(np.searchsorted(upto, level * self.total - 1e-9))
            row = f"{float(tops[i]):12.{DIGITS}f} {level:2.12f} {upto[i]:10d}"
            lines.append(f"{row} {1 / (1 - level):14.2f}" if level < 1 else row)
        buckets = max(1, int(self.largest).bit_length() - _HALF_MAGNITUDE)
        for left, one, right, other in (
            ("Mean", f"{self.mean:.{DIGITS}f}", "StdDeviation", f"{self.deviation:.{DIGITS}f}"),
            ("Max", f"{float(self.largest):.{DIGITS}f}", "TotalCount", str(self.total)),
            ("Buckets", str(buckets), "SubBuckets", str(2 * _HALF)),
        ):
            lines.append(f"#[{left:7} = {one:>12}, {right:14} = {other:>12}]")
        return "\n".join(lines) + "\n"


def histogram_log(
    histograms: Mapping[str, Histogram], *, start: float, seconds: float, comments: Iterable[str]
) -> str:
    """Return a histogram log with a line for each histogram, tagged with its name.

    Args:
        histograms: of values in ns; the column of largest values is told in ms, as is customary.
        start: when the first value was taken, seconds since the epoch.
        seconds: how long it took to take them.
        comments: lines that say what it is.
    """
    lines = [f"#{line}" for line in ("[Histogram log format version 1.3]", *comments)]
    lines.append(f"#[StartTime: {start:.3f} (seconds since epoch)]")
    lines.append(
        '"StartTimestamp","Interval_Length","Interval_Max","Interval_Compressed_Histogram"'
    )
    for name, histogram in histograms.items():
        tag = "".join("-" if mark in ", \n\r" else mark for mark in name)
        lines.append(
            f"Tag={tag},{0.0:.3f},{seconds:.3f},{histogram.largest / 1e6:.3f},{histogram.encode()}"
        )
    return "\n".join(lines) + "\n"


def _bucket(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the index of each value's bucket."""
    # frexp's exponent is the bit length: exact below 2^53, and times are far below.
    length = np.frexp(np.maximum(values, 2 * _HALF - 1).astype(np.float64))[1].astype(np.int64)
    shift = length - (_HALF_MAGNITUDE + 1)
    bucket: NDArray[np.int64] = ((shift + 1) << _HALF_MAGNITUDE) + (values >> shift) - _HALF
    return bucket


def _highest(buckets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the largest value of each bucket."""
    shift = np.maximum((buckets >> _HALF_MAGNITUDE) - 1, 0)
    within = np.where(buckets < _HALF, buckets, (buckets & (_HALF - 1)) + _HALF)
    highest: NDArray[np.int64] = ((within + 1) << shift) - 1
    return highest


def _levels(total: int) -> Iterable[float]:
    """Return shares, ever closer to 1, to beyond what the last of ``total`` values stands for."""
    level = 0.0
    while 1 - level > 1 / total:
        yield level
        halvings = int(np.floor(np.log2(1 / (1 - level)))) + 1
        level += 1 / (_TICKS * 2**halvings)
    yield 1.0


def _zigzag_runs(counts: NDArray[np.int64]) -> bytes:
    """Return counts as variable-length numbers; a row of empty buckets as its negative length."""
    result = bytearray()
    filled = np.flatnonzero(counts)
    before = -1
    for i in filled.tolist():
        empty = i - before - 1
        if empty:
            _put(result, -empty)
        _put(result, int(counts[i]))
        before = i
    return bytes(result)


def _put(result: bytearray, number: int) -> None:
    """Append a signed number: zigzag, then 7 bits a byte, the ninth byte whole."""
    left = (number << 1) ^ (number >> 63)
    left &= 2**64 - 1
    for _ in range(8):
        if left < 0x80:
            result.append(left)
            return
        result.append(left & 0x7F | 0x80)
        left >>= 7
    result.append(left)
