"""Reads XML into a tree of elements that know their file and line; nothing here knows about scenes.

The parser is the standard library's expat, whose `xml.etree` keeps no lines.

Document type declarations are refused, so that no entity is ever expanded and no outside file is fetched.
"""

from __future__ import annotations

import xml.parsers.expat
from dataclasses import dataclass, field


@dataclass(slots=True)
class Element:
    """One XML element.

    Attributes:
        tag: its name.
        attributes: name -> text, as written.
        file, line: where it begins, for messages.
        children: the elements in it, in document order.
    """

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list)

    def error(self, message: str, kind: type[Exception] = ValueError) -> Exception:
        """An exception that says where in which file this element is."""
        return kind(f"{self.file}, line {self.line}, <{self.tag}>: {message}")


def read_tree(content: bytes, file: str, most: int = 1 << 18) -> Element:
    """Parse XML text.

    Args:
        content: the document; its encoding is UTF-8 unless its first line says otherwise.
        file: its name, for messages.
        most: how many elements it may have.

    Raises:
        ValueError: with file and line, if it is not well-formed, holds text between elements, declares a document
            type or entities, or has too many elements.
    """
    if b"\0" in content[:4] or content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ValueError(f"{file}, line 1: expected text in UTF-8, got UTF-16 or binary data")
    parser = xml.parsers.expat.ParserCreate()
    parser.buffer_text = True
    roots: list[Element] = []
    stack: list[Element] = []
    left = most

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal left
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        left -= 1
        if left < 0:
            raise element.error("the scene has too many elements")
        (stack[-1].children if stack else roots).append(element)
        if len(stack) > 100:
            raise element.error("elements are nested more than 100 deep")
        stack.append(element)

    def end(_tag: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if data.strip():
            where = f"{file}, line {parser.CurrentLineNumber}, <{stack[-1].tag}>"
            raise ValueError(f"{where}: unexpected text {data.strip()[:40]!r}; values belong in attributes")

    def doctype(name: str, *_: object) -> None:
        line = parser.CurrentLineNumber
        raise ValueError(f"{file}, line {line}, <!DOCTYPE {name}>: document type declarations are not accepted")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content, True)
    except LookupError as error:
        raise ValueError(f"{file}, line 1: not well-formed XML: {error}") from None
    except xml.parsers.expat.ExpatError as error:
        inside = f", <{stack[-1].tag}>" if stack else ""
        reason = xml.parsers.expat.ErrorString(error.code)
        raise ValueError(f"{file}, line {error.lineno}{inside}: not well-formed XML: {reason}") from None
    return roots[0]
