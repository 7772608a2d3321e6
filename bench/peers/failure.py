"""Why a peer gives no figures, in one line."""

from __future__ import annotations

import re

_NOISE = re.compile(
    r"^(\[notice\]|WARNING|note:|hint:|╰─>|error: subprocess-exited|\s*$|make.*Error|Traceback)",
    re.IGNORECASE,
)
_ERROR = re.compile(r"^(ERROR:|[\w.]*(Error|Exception|Failure)\b.*:|.*\berror:)")
"""What a line looks like that names an error: worth more than what is printed after it."""
_LENGTH = 200


class PeerFailure(Exception):  # noqa: N818 - it is a finding, not an error of ours
    """A peer could not be installed or run; the text is the reason that its row shows."""


def last_words(output: str) -> str:
    """Return the last line of what a program printed that names an error, or says anything."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip() for line in output.splitlines()]
    said = [line for line in lines if re.search("[A-Za-z]", line) and not _NOISE.match(line)]
    text = next((line for line in reversed(said) if _ERROR.match(line)), said[-1] if said else "")
    return text if len(text) <= _LENGTH else text[: _LENGTH - 1] + "…"
