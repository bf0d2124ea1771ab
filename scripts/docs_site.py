"""Hooks of mkdocs: pages and files beside docs/ that the docs link to become part of the site."""

import os
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
BESIDE = ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "openapi.yaml", "LICENSE", "NOTICE", "CITATION.cff")
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)#\s]+)")


def on_files(files: Files, config: Any) -> Files:
    """Adds the files of the project's root, and results of benchmarks, to those of docs/."""
    for path in [*BESIDE, *(str(one.relative_to(ROOT)) for one in ROOT.glob("benchmarks/results/*.json"))]:
        files.append(File(path, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Makes links to files beside docs/, and theirs into docs/, links within the site."""
    source = Path(page.file.abs_src_path).parent
    here = Path(page.file.src_uri).parent

    def within(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(source / match[1]))
        inside = target.relative_to(ROOT / "docs") if target.is_relative_to(ROOT / "docs") else target.relative_to(ROOT)
        return os.path.relpath(inside, here)

    return LINK.sub(within, markdown)
