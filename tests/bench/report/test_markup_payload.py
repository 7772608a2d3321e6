"""What goes into the page: nothing breaks out of it, and numbers come back as they were."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from html.parser import HTMLParser

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.report.markup import Markup, element, join
from bench.report.payload import Payload


class Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.attributes, self.text = [], [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.text += data


@given(st.text(), st.text())
def test_text_and_attributes_stay_what_they_are(text, value):
    reader = Reader()
    reader.feed(element("p", text, element("b", "x"), title=value))
    reader.close()
    assert reader.tags == ["p", "b"]
    assert reader.attributes == [("title", value)]
    # a parser reads NUL and line ends its own way
    assert reader.text.replace("\r", "") == f"{text}x".replace("\r", "")


def test_names_and_flags_of_attributes():
    made = element("input", class_="a", aria_label="b", hidden=True, checked=False, id=None, size=3)
    assert made == '<input class="a" aria-label="b" hidden size="3">'
    assert join("<", None, Markup("<br>")) == "&lt;<br>"


def decoded(text: str):
    raw = zlib.decompress(base64.b64decode(text))
    (length,) = struct.unpack_from("<I", raw)
    header, at, columns = json.loads(raw[4 : 4 + length]), 4 + length, []
    assert at % 4 == 0
    for told in header["columns"]:
        n = told["length"]
        size = 4 * n if told["kind"] == "f" else 2 * n
        part = raw[at : at + size]
        if told["kind"] == "f":
            part = np.frombuffer(part, np.uint8).reshape(4, n).T.tobytes()
        columns.append(np.frombuffer(part, "<f4" if told["kind"] == "f" else "<u2"))
        at += size
    assert at == len(raw)
    return header, columns


@given(st.lists(st.lists(st.floats(width=32), max_size=30), max_size=6))
def test_columns_come_back_and_equal_ones_are_kept_once(lists):
    payload = Payload()
    arrays = [np.array(values, dtype=np.float64) for values in lists]
    numbers = [payload.add(values) for values in arrays]
    masks = payload.add(np.array([1, 2, 65535]))
    header, columns = decoded(payload.encode({"title": "</script>"}))
    assert header["title"] == "</script>"
    for number, values in zip(numbers, arrays, strict=True):
        np.testing.assert_array_equal(columns[number], values.astype(np.float32))
    assert columns[masks].tolist() == [1, 2, 65535]
    assert len(columns) == len({a.astype(np.float32).tobytes() for a in arrays}) + 1


def test_the_text_cannot_end_the_element_it_stands_in():
    text = Payload().encode({"a": "</script><script>"})
    assert set(text) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/=")
