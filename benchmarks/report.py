"""Writes ``docs/performance.md``, a page per benchmark and their plots: ``python -m benchmarks.report``."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from benchmarks import plots
from benchmarks.harness import RESULTS, cells_of, counted, number

ROOT = Path(__file__).parents[1]
NOTES = Path(__file__).parent / "notes"


class Section(NamedTuple):
    """One benchmark.

    Attributes:
        name: its module.
        title: of its page.
        minutes: how long it takes on two quiet cores.
        arguments: that it is run with.
    """

    name: str
    title: str
    minutes: int
    arguments: str = ""

    @property
    def command(self) -> str:
        return f"python -m benchmarks.{self.name}{self.arguments}"


SECTIONS = (
    Section("first_figure", "From a clone to the first figure", 10, " --clone"),
    Section("figures", "Quick forms of the figures", 15),
    Section("meta_training", "Algorithm 1 compared with PyTorch", 9),
    Section("shaping", "DQN compared with Stable-Baselines3, SBX and CleanRL's style", 5),
    Section("environments", "Environments compared with gymnax and Gymnasium", 7),
    Section("wrapper", "One step of the wrapper", 1),
    Section("meta_gradient", "The convolutional meta-gradient", 5),
    Section("scaling", "How time grows", 6),
    Section("memory", "How memory grows", 18),
    Section("devices", "Two cores compared with one", 3),
    Section("profile", "Where the time goes", 4),
    Section("maps", "Grid games", 2),
    Section("host_meta_training", "Meta-training on Gymnasium environments", 3),
    Section("checkpoints", "Checkpoints", 5),
)

_WRITTEN = "<!-- Written by `python -m benchmarks.report`; edit benchmarks/notes instead. -->"


@dataclass(frozen=True)
class Options:
    """Input and output folders.

    Attributes:
        results: folder of the JSON files.
        docs: folder that gets ``performance.md`` and ``performance/``.
    """

    results: Path = RESULTS
    docs: Path = ROOT / "docs"


def main(options: Options) -> None:
    """Writes all pages and plots."""
    measured = results(options.results)
    (options.docs / "performance").mkdir(parents=True, exist_ok=True)
    plots.draw_all(measured, options.docs / "performance")
    for path, text in pages(measured).items():
        (options.docs / path).write_text(text, encoding="utf-8")
    print(f"{len(measured)} of {len(SECTIONS)} benchmarks written to {options.docs / 'performance.md'}.")


def results(folder: Path) -> dict[str, Any]:
    """The contents of the JSON files, by benchmark."""
    files = {section.name: folder / f"{section.name}.json" for section in SECTIONS}
    return {name: json.loads(path.read_text(encoding="utf-8")) for name, path in files.items() if path.exists()}


def pages(measured: dict[str, Any]) -> dict[str, str]:
    """The text of every page, by its path from ``docs/``."""
    texts = {"performance.md": overview(measured)}
    texts["performance/tried.md"] = _joined(["# What was tried", _WRITTEN, _note("tried")])
    pictures = plots.pictures(measured)
    for section in SECTIONS:
        parts = page(section, measured.get(section.name), pictures.get(section.name))
        texts[f"performance/{section.name}.md"] = _joined(parts)
    return texts


def overview(measured: dict[str, Any]) -> str:
    """The first page: what each benchmark asks, and how many of its bars are met."""
    body = []
    for section in SECTIONS:
        content = measured.get(section.name)
        body.append([f"[{section.title}](performance/{section.name}.md)", _verdicts(content), _day(content)])
    table = markdown(["benchmark", "bars", "measured on"], body, words=("bars", "measured on"))
    return _joined(["# Performance", _WRITTEN, _note("introduction"), table, _note("more")])


def _verdicts(content: Any) -> str:
    if content is None:
        return "not measured yet"
    bars = content["bars"]
    met = sum(bar["verdict"] == "met" for bar in bars)
    return f"{met} of {len(bars)} met" if bars else "none set"


def _day(content: Any) -> str:
    return "" if content is None else content["written"][:10]


def page(section: Section, content: Any, picture: str | None) -> Iterator[str]:
    """One benchmark: its notes, its command, its numbers and its bars."""
    yield f"# {section.title}"
    yield _WRITTEN
    yield _note(section.name)
    yield f"`{section.command}` takes about {counted(section.minutes, 'minute')} on two quiet cores."
    if content is None:
        yield "Not measured yet."
        return
    yield markdown(*cells_of(content["rows"], content["unit"]))
    if picture:
        yield f"![{section.title}]({picture})"
    for extra in _EXTRAS.get(section.name, ()):
        if content.get(extra):
            yield extra_table(extra, content[extra])
    if content["bars"]:
        yield "## Bars"
        yield bars_table(content["bars"])
    yield origin(content)


_EXTRAS = {"meta_training": ("curves",), "scaling": ("fits",)}


def bars_table(bars: Iterable[dict[str, Any]]) -> str:
    """Every bar, the measurement, and what limits it where it is missed or met by a narrow margin."""
    body = []
    for bar in bars:
        measured = "" if bar["measured"] is None else number(bar["measured"])
        needs_reason = bar["verdict"].startswith("missed") or bar.get("close", False)
        body.append([bar["what"], measured, bar["verdict"], bar["bound"] if needs_reason else ""])
    return markdown(["bar", "measured", "verdict", "what limits it"], body, words=("verdict", "what limits it"))


def extra_table(title: str, rows: dict[str, dict[str, Any]]) -> str:
    """A dict of dicts of numbers; lists become their length and range."""
    heads = list(dict.fromkeys(key for row in rows.values() for key in row))
    body = [[name, *(_cell(row.get(head, "")) for head in heads)] for name, row in rows.items()]
    return markdown([title, *heads], body)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)} between {number(min(value))} and {number(max(value))}"
    return number(value)


def origin(content: Any) -> str:
    """When, how often, at which commit and on what a benchmark was measured."""
    hardware, versions = content["hardware"], content["versions"]
    commit, load = versions.get("commit", ""), hardware.get("load")
    at_commit = f" at commit {commit[:10]}{commit[40:]}" if commit else ""
    at_load = f", load {load[0]:.1f} at the end" if load else ""
    exactly = [f"{what} {hardware[key]}" for what, key in _EXACTLY.items() if key in hardware]
    processor = hardware["processor"] + (f" ({', '.join(exactly)})" if exactly else "")
    memory = f", {hardware['memory, GiB']:g} GiB" if "memory, GiB" in hardware else ""
    packages = ", ".join(f"{package} {version}" for package, version in versions.items() if package != "commit")
    return (
        f"Measured {content['written'][:16].replace('T', ' ')} UTC{at_commit}, "
        f"{counted(content['settings']['repeats'], 'repeat')} in turns{at_load}, on {processor}, "
        f"{hardware['cores']} cores{memory}, {hardware['system']}; {packages}."
    )


_EXACTLY = {"family": "processor's family", "model": "processor's model"}


def markdown(heads: list[str], body: list[list[str]], words: tuple[str, ...] = ()) -> str:
    """A table; numbers are aligned right, the first column and those named in ``words`` left."""
    lines = [heads, ["---", *("---" if head in words else "---:" for head in heads[1:])], *body]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _note(name: str) -> str:
    return (NOTES / f"{name}.md").read_text(encoding="utf-8").strip()


def _joined(parts: Iterable[str]) -> str:
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Options))
