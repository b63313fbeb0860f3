"""All figures and theorems of the paper, one after the other, and one page that links to them."""

import html
import io
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from upslope.experiments.catalogue import reproduce
from upslope.run.folder import claim
from upslope.storage import write_atomically

#: The experiments, and the titles of their sections of the page.
CHAPTERS: dict[str, str] = {
    "theorems": "The theorems, on thousands of maps",
    "fig1": "Figure 1: CartPoles",
    "fig2": "Figure 2: learned V on clean maps",
    "fig3": "Figure 3: adaptation and shaping on clean maps",
    "fig4": "Figure 4: learned V on maps with obstacles",
    "fig5": "Figure 5: adaptation and shaping on maps with obstacles",
}

#: The chapter whose priors a chapter reuses, so that they are trained once.
PRIORS_OF = {"fig3": "fig2", "fig5": "fig4"}

#: Pictures and files of a chapter that the page shows or links to, if they exist.
PICTURES = ("figure.png", "map.png", "sheet.png")
FILES = ("report.html", "tables.md", "results.json", "returns.npz", "maps.npz")


def reproduce_all(
    *,
    out: Path | None = None,
    is_quick: bool = False,
    first_seed: int = 0,
    resume: bool = False,
    console: Console | None = None,
) -> None:
    """Reproduces each chapter into its own folder, and writes report.html next to these folders after each.

    Args:
        out: the folder; a new one under ``runs/`` if None.
        is_quick: run the quick forms.
        first_seed: selects other seeds and other test tasks.
        resume: continue the run in ``out``, which was started with the same settings.
        console: where the summaries are printed.

    Raises:
        UpslopeError: as in `reproduce`.
    """
    console = console or Console()
    settings: dict[str, Any] = {"is_quick": is_quick, "first_seed": first_seed}
    with claim(out, "all", settings, resume=resume) as folder:
        summaries: dict[str, tuple[str, float]] = {}
        for name, title in CHAPTERS.items():
            console.rule(title)
            record = Console(record=True, width=110, file=io.StringIO())
            start = time.perf_counter()
            chapter = folder / name
            is_started = resume and (chapter / "run.json").is_file()
            priors_of = folder / PRIORS_OF[name] if name in PRIORS_OF else None
            reproduce(
                name,
                out=chapter,
                is_quick=is_quick,
                first_seed=first_seed,
                priors_of=priors_of,
                resume=is_started,
                console=record,
            )
            summaries[name] = record.export_text(), time.perf_counter() - start
            console.print(summaries[name][0], highlight=False)
            write_atomically(folder / "report.html", _page(folder, summaries, is_quick).encode())
    console.print(f"[bold]{folder / 'report.html'}[/bold] links to all results.")


def _page(folder: Path, summaries: dict[str, tuple[str, float]], is_quick: bool) -> str:
    quick = "<p class='quick'>These are the quick forms: too small to say anything about the paper.</p>"
    sections = "\n".join(_section(folder, name, *summary) for name, summary in summaries.items())
    contents = "\n".join(f"<li><a href='#{name}'>{html.escape(CHAPTERS[name])}</a></li>" for name in summaries)
    return _PAGE.format(quick=quick if is_quick else "", contents=contents, sections=sections)


def _section(folder: Path, name: str, summary: str, seconds: float) -> str:
    def existing(names: tuple[str, ...]) -> list[str]:
        return [f"{name}/{file}" for file in names if (folder / name / file).is_file()]

    pictures = "\n".join(f"<a href='{path}'><img alt='{path}' src='{path}'></a>" for path in existing(PICTURES))
    links = " · ".join(f"<a href='{path}'>{path}</a>" for path in existing(FILES))
    return (
        f"<h2 id='{name}'>{html.escape(CHAPTERS[name])}</h2>\n<p>{links} · {seconds:.0f} s</p>\n"
        f"{pictures}\n<pre>{html.escape(summary)}</pre>"
    )


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Reward Shaping via Meta-Learning, reproduced</title>
<style>
 body {{ font: 16px/1.5 Georgia, serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
 h1, h2 {{ font-weight: normal; }} h2 {{ margin-top: 2.5rem; }} img {{ max-width: 100%; }}
 pre {{ font-size: 13px; line-height: 1.3; overflow-x: auto; }} .quick {{ color: #b2182b; font-weight: bold; }}
</style></head><body>
<h1>Reward Shaping via Meta-Learning, reproduced</h1>
{quick}
<ul>
{contents}
</ul>
{sections}
</body></html>
"""
