"""Pages that stand alone: one HTML file holds our scripts, our styles and all data, and needs no network."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

# Nothing is loaded, sent or framed, whatever a page's data hold.
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'"
)
_PAGE: Final = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="generator" content="guided-gym">
<title>{title}</title>
<style>
{style}
</style>
</head>
<body>
{body}
{scripts}
</body>
</html>
"""


@cache
def web_file(name: str) -> str:
    """The text of one of our scripts or styles."""
    return files("guided_gym.display").joinpath("web", name).read_text(encoding="utf-8")


def page(
    title: str, body: str, *, scripts: Sequence[str] = (), styles: Sequence[str] = ("theme.css",)
) -> str:
    """A page of its own.

    Args:
        title: Any text.
        body: HTML, whose texts are escaped already (`escaped`, `embedded`).
        scripts: Names of files in ``web/``, run after the body in this order.
        styles: Likewise.
    """
    code = "\n".join(f"<script>\n{web_file(name)}</script>" for name in scripts)
    style = "\n".join(map(web_file, styles))
    return _PAGE.format(policy=_POLICY, title=escaped(title), style=style, body=body, scripts=code)


def escaped(text: object) -> str:
    """A text as HTML that shows it as it is."""
    return html.escape(str(text), quote=True)


def embedded(data: Any, *, name: str = "", kind: str = "") -> str:
    """A script element that holds JSON and runs nothing, whatever texts are in it.

    Args:
        data: JSON-able, without NaN.
        name: The element's id.
        kind: Its class.
    """
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    attributes = "".join(
        f' {key}="{escaped(value)}"' for key, value in (("id", name), ("class", kind)) if value
    )
    return f'<script type="application/json"{attributes}>{text}</script>'
