"""Writes ``docs/performance.md`` and its plots from the results of all benchmarks: ``python -m benchmarks.report``."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks import plots
from benchmarks.harness import RESULTS, cells_of, counted, number

ROOT = Path(__file__).parents[1]
NOTES = Path(__file__).parent / "notes"

#: Sections in their order: the benchmark, its title, what it is run with, and how long that takes on two quiet cores.
SECTIONS = (
    ("first_figure", "From nothing to the first figure", " --clone", "10 minutes"),
    ("figures", "Quick forms of the figures", "", "15 minutes"),
    ("meta_training", "Algorithm 1 against PyTorch", "", "9 minutes"),
    ("shaping", "DQN learners against Stable-Baselines3, SBX and CleanRL's manner", "", "5 minutes"),
    ("environments", "Environments against gymnax and Gymnasium", "", "7 minutes"),
    ("wrapper", "The wrapper, a step", "", "1 minute"),
    ("meta_gradient", "The convolutional meta-gradient", "", "5 minutes"),
    ("scaling", "How time grows", "", "6 minutes"),
    ("memory", "How memory grows", "", "18 minutes"),
    ("devices", "Two cores against one", "", "3 minutes"),
    ("profile", "Where the time goes", "", "4 minutes"),
    ("maps", "Grid games", "", "2 minutes"),
    ("host_meta_training", "Meta-training on Gymnasium environments", "", "3 minutes"),
    ("checkpoints", "Checkpoints", "", "5 minutes"),
)


@dataclass(frozen=True)
class Options:
    """Where from and where to.

    Attributes:
        results: folder of the JSON files.
        docs: folder that gets ``performance.md`` and ``performance/``.
    """

    results: Path = RESULTS
    docs: Path = ROOT / "docs"


def main(options: Options) -> None:
    """Writes the page."""
    found = results(options.results)
    (options.docs / "performance").mkdir(parents=True, exist_ok=True)
    plots.draw_all(found, options.docs)
    (options.docs / "performance.md").write_text(page(found), encoding="utf-8")
    print(f"{len(found)} of {len(SECTIONS)} benchmarks written to {options.docs / 'performance.md'}.")


def results(folder: Path) -> dict[str, Any]:
    """The contents of the JSON files, by benchmark."""
    files = {name: folder / f"{name}.json" for name, *_ in SECTIONS}
    return {name: json.loads(path.read_text(encoding="utf-8")) for name, path in files.items() if path.exists()}


def page(found: dict[str, Any]) -> str:
    """The whole page from the contents of the JSON files."""
    pictures = plots.pictures(found)
    parts = [
        "# How long it takes",
        "<!-- Written by `python -m benchmarks.report`; edit benchmarks/notes, not this. -->",
        (NOTES / "introduction.md").read_text(encoding="utf-8").strip(),
        machines(found),
        "## The bars",
        bars_table(found),
    ]
    for name, title, arguments, minutes in SECTIONS:
        parts += [f"## {title}", *section(name, arguments, minutes, found.get(name), pictures.get(name))]
    parts.append((NOTES / "tried.md").read_text(encoding="utf-8").strip())
    return "\n\n".join(parts) + "\n"


def section(name: str, arguments: str, minutes: str, content: Any, picture: str | None) -> Iterable[str]:
    """What a benchmark is, what it found, and how to repeat it."""
    notes = NOTES / f"{name}.md"
    if notes.exists():
        yield notes.read_text(encoding="utf-8").strip()
    yield f"`python -m benchmarks.{name}{arguments}`, about {minutes} on two quiet cores."
    if content is None:
        yield "Not measured yet."
        return
    heads, body = cells_of(content["rows"], content["unit"])
    yield markdown(heads, body)
    if picture:
        yield f"![{name}]({picture})"
    for extra in _EXTRAS.get(name, ()):
        if content.get(extra):
            yield extra_table(extra, content[extra])
    if content["bars"]:
        yield bars_table({name: content})
    load = content["hardware"].get("load")
    written, repeats = content["written"][:16].replace("T", " "), content["settings"]["repeats"]
    at_the_end = f", load {load[0]:.1f} at the end" if load else ""
    commit = content["versions"].get("commit", "")
    made = f" at commit {commit[:10]}{commit[40:]}" if commit else ""
    yield f"Measured {written} UTC{made}, {counted(repeats, 'repeat')} in turns{at_the_end}."


_EXTRAS = {"meta_training": ("curves",), "scaling": ("fits",)}


def bars_table(found: dict[str, Any]) -> str:
    """Every bar, what was measured, and what bounds it where it is missed."""
    body = []
    for content in found.values():
        for bar in content["bars"]:
            measured = "" if bar["measured"] is None else number(bar["measured"])
            told = bar["verdict"].startswith("missed") or bar.get("close", False)
            bound = bar["bound"] if told else ""
            body.append([bar["what"], measured, bar["verdict"], bound])
    return markdown(["bar", "measured", "", "what bounds it"], body) if body else "None was measured yet."


def extra_table(title: str, rows: dict[str, dict[str, Any]]) -> str:
    """A dict of dicts of numbers; lists become their length and range."""
    heads = list(dict.fromkeys(key for row in rows.values() for key in row))
    body = [[name, *(_cell(row.get(head, "")) for head in heads)] for name, row in rows.items()]
    return markdown([title, *heads], body)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)} between {number(min(value))} and {number(max(value))}"
    return number(value)


def machines(found: dict[str, Any]) -> str:
    """Hardware and versions, each different one once."""
    lines = {}
    for name, content in found.items():
        hardware, versions = content["hardware"], content["versions"]
        exactly = [f"{what} {hardware[key]}" for what, key in _EXACTLY.items() if key in hardware]
        processor = hardware["processor"] + (f" ({', '.join(exactly)})" if exactly else "")
        memory = f", {hardware['memory, GiB']:g} GiB" if "memory, GiB" in hardware else ""
        packages = ", ".join(f"{package} {version}" for package, version in versions.items() if package != "commit")
        said = f"{processor}, {hardware['cores']} cores{memory}, {hardware['system']}; {packages}"
        lines.setdefault(said, []).append(name)
    if len(lines) == 1:
        return f"Measured on: {next(iter(lines))}."
    return "\n".join(f"- {', '.join(names)}: {said}." for said, names in lines.items())


_EXACTLY = {"family": "processor's family", "model": "processor's model"}


def markdown(heads: list[str], body: list[list[str]]) -> str:
    """A table, numbers on the right."""
    lines = [heads, ["---", *(f"---{'' if head in _WORDS else ':'}" for head in heads[1:])], *body]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


_WORDS = ("", "what bounds it")

if __name__ == "__main__":
    main(tyro.cli(Options))
