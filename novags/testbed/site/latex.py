"""A table of a page as LaTeX, for booktabs."""

from markupsafe import Markup, escape

from novags.testbed.report.parts import Table, TableCell

SIGNS = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "−": "$-$",
         "†": r"$^\dagger$", "°": r"$^\circ$", "×": r"$\times$", "²": "$^2$", "Δ": r"$\Delta$"}  # fmt: skip
ESCAPED = "&%$#_{}"


def latex(table: Table) -> str:
    """The whole table; columns that say the same in every row are left out, the best of a column is bold."""
    shown = [k for k in range(len(table.columns)) if k not in table.same]
    heads = [_safe(f"{table.columns[k].heading} {table.columns[k].unit}".strip()) for k in shown]
    lines = [[_cell(row.cells[k]) for k in shown] for row in table.rows]
    sides = "".join("r" if table.columns[k].kind == "num" else "l" for k in shown)
    body = "".join(f"{' & '.join(cells)} \\\\\n" for cells in lines)
    return (f"\\begin{{tabular}}{{{sides}}}\n\\toprule\n{' & '.join(heads)} \\\\\n\\midrule\n{body}\\bottomrule\n"
            "\\end{tabular}\n")  # fmt: skip


def _cell(cell: object) -> str:
    said = _safe(Markup(escape(cell.text if isinstance(cell, TableCell) else cell)).striptags())
    best = isinstance(cell, TableCell) and cell.attributes is not None and ' class="num best"' in cell.attributes
    return f"\\textbf{{{said}}}" if best else said


def _safe(text: str) -> str:
    return "".join(SIGNS.get(sign, f"\\{sign}" if sign in ESCAPED else sign) for sign in text)
