"""Hooks of MkDocs: files from outside the folder docs become pages of the site."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

OUTSIDE = ('CONTRIBUTING.md',)
"""Files of the folder above docs that are pages of the site."""


def on_files(files: Any, config: Any) -> Any:
    """Add the files from outside."""
    for name in OUTSIDE:
        text = (Path(config.docs_dir).parent / name).read_text(encoding='utf-8')
        files.append(File.generated(config, name, content=text.replace('](docs/', '](')))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let links to these files lead to their pages."""
    for name in OUTSIDE:
        markdown = markdown.replace(f'](../{name}', f']({name}')
    return markdown
