"""Text that others wrote cannot control the terminal: names, messages and log lines may hold anything.

A control character could clear the screen, set its title or write the clipboard, and a change of direction
shows one text as another. In all that is printed, the sign for what cannot be shown replaces each of them.
"""

import re
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from typing import Any, TextIO, cast

import rich.console
from rich.segment import Segment

# All but line feed and tab: C0, DEL and C1; and what overrides or isolates a direction.
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def plain(text: str) -> str:
    """The text with such characters replaced."""
    return _UNSAFE.sub("�", text)


def escaped(document: str) -> str:
    """A JSON document that means the same, without such characters."""
    return _UNSAFE.sub(lambda found: f"\\u{ord(found[0]):04x}", document)


class Console(rich.console.Console):
    """Rich's; the codes that it prints itself stay."""

    def render(self, renderable: Any, options: Any = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(plain(segment.text), segment.style)


class _Plain:
    """A stream for `print`. Rich finds the real one by the name that it has for such a case."""

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        return self.rich_proxied_file.write(plain(text))

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextmanager
def plain_output() -> Generator[None]:
    """While it lasts, nothing that is printed can control the terminal."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast("TextIO", _Plain(stream)) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
