"""Claims about tables as LaTeX."""

from novags.testbed.report.parts import Column, Table, TableCell, TableRow, num, text
from novags.testbed.site.latex import latex


def test_latex_escapes_marks_the_best_and_leaves_out_what_is_alike() -> None:
    rows = [TableRow([TableCell("a_b & c"), text("same"), num(1.0, "1.0 ± 0.2", best=True), "50 %"]),
            TableRow([text("d^2~\\"), text("same"), num(-2.0, "−2.0"), "x#{$}†"])]  # fmt: skip
    made = latex(Table("t", "", [Column("Who"), Column("Said"), Column("PSNR", "dB", "num"), Column("Share")], rows))
    assert made == (
        "\\begin{tabular}{lrl}\n\\toprule\nWho & PSNR dB & Share \\\\\n\\midrule\n"
        "a\\_b \\& c & \\textbf{1.0 $\\pm$ 0.2} & 50 \\% \\\\\n"
        "d\\textasciicircum{}2\\textasciitilde{}\\textbackslash{} & $-$2.0 & x\\#\\{\\$\\}$^\\dagger$ \\\\\n"
        "\\bottomrule\n\\end{tabular}\n"
    )
