"""What a report page must be, whichever report it is: well formed, and complete without a network."""

import re
from html.parser import HTMLParser


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data")]
        if tag not in ("meta", "link", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)


def read(html: str) -> str:
    """What a person reads; fails where the page is malformed or asks for anything outside itself."""
    parser = _Page()
    parser.feed(html)
    assert parser.open == []
    assert parser.links
    # Files that lie beside the page may be linked; nothing is loaded.
    assert all(link.startswith("data:") or re.fullmatch(r"\w+\.\w+", link) for link in parser.links)
    assert "https://" not in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    return " ".join(parser.text)
