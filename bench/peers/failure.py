"""Why a peer gives no figures, in one line."""

from __future__ import annotations

import re

_NOISE = re.compile(
    r"^(\[notice\]|WARNING|note:|hint:|╰─>|error: subprocess-exited|\s*$|make.*Error|Traceback)",
    re.IGNORECASE,
)
_LENGTH = 200


class PeerFailure(Exception):  # noqa: N818 - it is a finding, not an error of ours
    """A peer could not be installed or run; the text is the reason that its row shows."""


def last_words(output: str) -> str:
    """Return the last line of what a program printed that says something, shortened."""
    for line in reversed(output.splitlines()):
        text = re.sub(r"\x1b\[[0-9;]*m", "", line).strip()
        if text and not _NOISE.match(text) and any(letter.isalpha() for letter in text):
            return text if len(text) <= _LENGTH else text[: _LENGTH - 1] + "…"
    return ""
