"""The page: sections of words, tables and places for figures, and everything they need inline."""

import base64
import hashlib
import importlib.metadata
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from bench.report.drawing import Figure
from bench.report.errors import ReportError
from bench.report.markup import Attribute, Markup, element
from bench.report.payload import packed

GENERATOR = "pulsempc report"
_MOST_SENTENCES = 4
"""Sentences under a figure that are shown at once."""


def section(id_: str, title: str, *parts: Markup | None) -> Markup:
    """Return a section of the page with its heading."""
    return element(
        "section",
        element("h2", title, id=f"{id_}-title"),
        *parts,
        id=id_,
        aria_labelledby=f"{id_}-title",
    )


def place(figure: Figure) -> Markup:
    """Return the place of a figure: title, legend, drawing area, and what it shows in words."""
    name = figure.id
    sentences = element("ul", *(element("li", text) for text in figure.caption))
    if len(figure.caption) > _MOST_SENTENCES:
        sentences = element(
            "details", element("summary", "In numbers"), sentences, class_="numbers"
        )
    return element(
        "figure",
        element(
            "div",
            element("h3", figure.title, id=f"title-{name}"),
            element(
                "button", "Save as SVG", id=f"save-{name}", type="button", hidden=True,
                aria_label=f"Save as SVG: {figure.title}",
            ),
            class_="head",
        ),
        element(
            "div", id=f"legend-{name}", class_="legend", role="group",
            aria_label=f"Legend: {figure.title}",
        ),
        element(
            "div", id=f"plot-{name}", class_="plot", role="img", data_figure=name,
            aria_labelledby=f"title-{name}", aria_describedby=f"words-{name}",
            style=f"height:{figure.height}px",
        ),
        element("figcaption", sentences, id=f"words-{name}"),
        class_="figure",
    )  # fmt: skip


def time_bar() -> Markup:
    """Return the controls of the window in time that all figures over time share."""
    moves = (
        ("out", "\N{MINUS SIGN}", "Show twice the time"),
        ("in", "+", "Show half the time"),
        ("earlier", "◀", "Go back"),
        ("later", "▶", "Go on"),
        ("all", "All", "Show the whole time"),
    )
    box: dict[str, Attribute] = {"type": "number", "step": "any", "inputmode": "decimal"}
    return element(
        "div",
        element("label", "From", element("input", id="time-from", **box)),
        element("label", "to", element("input", id="time-to", **box), "s"),
        element(
            "span",
            *(
                element(
                    "button", sign, type="button", data_move=move, aria_label=label, title=label
                )
                for move, sign, label in moves
            ),
            class_="moves",
        ),
        element(
            "label",
            element("input", type="checkbox", id="time-fit", checked=True),
            "fit vertical scales",
        ),
        element("span", id="time-told", role="status", class_="told"),
        class_="timebar", id="timebar", role="group", aria_label="Window in time", hidden=True,
    )  # fmt: skip


def page(
    *,
    title: str,
    lead: Sequence[str],
    notes: Sequence[str],
    sections: Sequence[tuple[str, str, Markup]],
    payload: str,
    footer: str,
) -> str:
    """Return the whole page.

    Args:
        title: of the page.
        lead: sentences under it.
        notes: what has to be known before anything is read.
        sections: id, title for the list of contents, and the section itself.
        payload: see `bench.report.payload`.
        footer: who made it.

    Raises:
        ReportError: Plotly is not installed.
    """
    script = _asset("report.js")
    plotly = plotly_script()
    policy = "; ".join(
        (
            "default-src 'none'",
            f"script-src {_hash(script.encode())} {_hash(plotly)}",
            "style-src 'unsafe-inline'",
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="generator", content=GENERATOR),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"{title}: pulsempc report"),
        element("style", Markup(_asset("report.css"))),
    )
    header = element(
        "header",
        element(
            "div",
            element("p", "pulsempc report", class_="what"),
            element("h1", title),
            *(element("p", sentence) for sentence in lead),
        ),
        element("button", "Dark theme", id="theme", type="button", hidden=True),
    )
    contents = element(
        "nav",
        element(
            "ul",
            *(element("li", element("a", name, href=f"#{id_}")) for id_, name, _ in sections),
        ),
        aria_label="Contents",
    )
    warning = (
        element("div", *(element("p", note) for note in notes), class_="notes", role="note")
        if notes
        else None
    )
    main = element(
        "main",
        warning,
        element("p", id="problem", role="alert", class_="notes", hidden=True),
        element(
            "noscript",
            element(
                "p",
                "Scripts are off: figures are not drawn. The tables and the sentences under each "
                "figure hold what they show.",
                class_="notes",
            ),
        ),
        *(body for _, _, body in sections),
        id="main",
        tabindex="-1",
    )
    body = element(
        "body",
        element("a", "Skip to the content", href="#main", class_="skip"),
        header,
        contents,
        main,
        element("footer", element("p", footer)),
        _data("payload", payload),
        _data("plotly", packed(plotly)),
        element("script", Markup(script)),
    )
    return "<!doctype html>\n" + element("html", head, body, lang="en") + "\n"


def plotly_script() -> bytes:
    """Return the JavaScript of Plotly as its Python package brings it.

    Raises:
        ReportError: it is not there.
    """
    try:
        found = importlib.metadata.distribution("plotly")
        path = Path(str(found.locate_file("plotly/package_data/plotly.min.js")))
        return path.read_bytes()
    except importlib.metadata.PackageNotFoundError:
        raise ReportError(Path("plotly"), "not installed; pip install plotly") from None
    except OSError as error:
        raise ReportError(Path("plotly"), f"its script is missing: {error.strerror}") from None


def _data(id_: str, text: str) -> Markup:
    """Return a block that no browser runs or shows."""
    return element("script", text, id=id_, type="text/plain")


def _asset(name: str) -> str:
    return (resources.files("bench.report") / "assets" / name).read_text(encoding="utf-8")


def _hash(script: bytes) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script).digest()).decode()}'"
