"""HTML that cannot be broken by what is put into it: text is escaped, elements are not."""

from html import escape

_VOID = {"meta", "input", "br", "img", "col"}


class Markup(str):
    """HTML that may stand on a page as it is; plain strings are text and are escaped."""

    __slots__ = ()


Child = str | None
Attribute = str | int | float | bool | None


def element(tag: str, *children: Child, **attributes: Attribute) -> Markup:
    """Return an element.

    Args:
        tag: its name.
        children: text, which is escaped, or `Markup`; None is left out.
        attributes: an underscore is a hyphen, and dropped at the end (``aria_label``, ``class_``);
            True gives the bare name, False and None leave it out.
    """
    written = "".join(_attribute(name, value) for name, value in attributes.items())
    if tag in _VOID:
        return Markup(f"<{tag}{written}>")
    return Markup(f"<{tag}{written}>{join(*children)}</{tag}>")


def join(*children: Child) -> Markup:
    """Return children one after the other, text escaped."""
    return Markup(
        "".join(
            child if isinstance(child, Markup) else escape(child)
            for child in children
            if child is not None
        )
    )


def _attribute(name: str, value: Attribute) -> str:
    if value is None or value is False:
        return ""
    name = name.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{escape(str(value))}"'
