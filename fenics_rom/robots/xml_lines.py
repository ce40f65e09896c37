"""Elements of an XML file that know their line."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from fenics_rom.errors import SceneError


@dataclass(eq=False)
class Element:
    """One of a file."""

    tag: str
    given: dict[str, str]
    line: int
    children: "list[Element]" = field(default_factory=list)

    def all(self, tag: str) -> "list[Element]":
        """Children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> "Element | None":
        """The first of these; None where there is none."""
        return next(iter(self.all(tag)), None)

    def everywhere(self) -> "Iterator[Element]":
        """It, and all that is in it."""
        yield self
        for child in self.children:
            yield from child.everywhere()

    def text(self) -> str:
        """As XML."""
        given = "".join(f" {name}={quoteattr(value)}" for name, value in self.given.items())
        return f"<{self.tag}{given}>{''.join(child.text() for child in self.children)}</{self.tag}>"


def read_elements(text: str, source: str) -> Element:
    """The root of a file.

    Raises:
        SceneError: it is no XML, with the line.
    """
    parser, open_ones, roots = expat.ParserCreate(), list[Element](), list[Element]()

    def start(tag: str, given: dict[str, str]) -> None:
        element = Element(tag, given, parser.CurrentLineNumber)
        (open_ones[-1].children if open_ones else roots).append(element)
        open_ones.append(element)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_ones.pop()
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise SceneError(f"{source}, line {error.lineno}: no XML: {expat.errors.messages[error.code]}") from error
    return roots[0]
