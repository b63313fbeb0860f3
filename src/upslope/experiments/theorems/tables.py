"""The results of the theorems as Markdown tables: tables.md, and the tables of docs/theorems.md."""

from typing import Any


def tables(results: dict[str, Any]) -> str:
    """All tables, as tables.md holds them."""
    return "\n\n".join([invariance_tables(results), credit_table(results), alternation_table(results)]) + "\n"


def invariance_tables(results: dict[str, Any]) -> str:
    """Thm. 2.1: one table for each kind of maps, separated by blank lines."""
    rows = results["invariance"]
    potentials = list(next(iter(rows.values())))
    parts = []
    for kind, by_potential in rows.items():
        lines = [f"| {kind}: what is added to R | " + " | ".join(f"Φ {name}" for name in potentials) + " |"]
        lines.append("|---" * (1 + len(potentials)) + "|")
        for added in next(iter(by_potential.values())):
            cells = [by_potential[name][added] for name in potentials]
            shown = " | ".join(f"{100 * cell['changed']:.1f} % / {100 * cell['solved']:.1f} %" for cell in cells)
            lines.append(f"| {added} | {shown} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def credit_table(results: dict[str, Any]) -> str:
    """Thm. 3.1."""
    lines = [
        "| maps | states | optimal actions: largest size | others: largest | one outcome: largest "
        "| solved: V* | Manhattan | no potential |",
        "|---" * 8 + "|",
    ]
    for kind, row in results["credit"].items():
        solved = " | ".join(f"{100 * row['solved'][name]:.1f} %" for name in ("V*", "Manhattan", "none"))
        numbers = f"{row['optimal_size']:.0e} | {row['other_largest']:.0e} | {row['single_largest']:.2g}"
        lines.append(f"| {row['maps']} × {kind} | {row['states']} | {numbers} | {solved} |")
    return "\n".join(lines)


def alternation_table(results: dict[str, Any]) -> str:
    """Thm. 3.2 on tables of values."""
    lines = ["| maps | start and ratio | converged | median map, V | worst map, V |", "|---" * 5 + "|"]
    for kind, row in results["alternation"].items():
        for start, end in row["starts"].items():
            share = f"{100 * end['converged']:.1f} %"
            ends = f"{end['median'][-1]:.0e} | {end['worst'][-1]:.0e}"
            lines.append(f"| {row['maps']} × {kind} | {start} | {share} | {ends} |")
    return "\n".join(lines)
