"""Runs the notebooks of this folder with their outputs: `python docs/examples/notebooks.py [--write] NAME…`.

It needs what the notebooks need and nothing more. Without `--write` the texts are compared with those that are stored,
and a difference ends it with exit code 1; numbers may differ by 2 %, as processors round differently.
"""

from __future__ import annotations

import argparse
import ast
import base64
import io
import json
import os
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).parent
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
SAME = 0.02
DPI = 45


def run_cell(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Return the outputs of a cell: what it prints, the figures that it draws, and the value of its last line."""
    tree, said, value = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with redirect_stdout(said):
        exec(compile(tree, "cell", "exec"), names)  # noqa: S102 - of this repository
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # noqa: S307 - same
    outputs: list[dict[str, Any]] = []
    if said.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": said.getvalue().splitlines(keepends=True)})
    if plt.get_fignums():
        for figure in map(plt.figure, plt.get_fignums()):
            target = io.BytesIO()
            figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})
            image = base64.b64encode(target.getvalue()).decode()
            outputs.append({"output_type": "display_data", "data": {"image/png": image}, "metadata": {}})
        plt.close("all")
    elif value is not None:
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        outputs.append({"output_type": "execute_result", "data": data, "metadata": {}, "execution_count": number})
    return outputs


def run(notebook: dict[str, Any]) -> None:
    """Run the cells of a notebook in their order and store their outputs in it."""
    names: dict[str, Any] = {"__name__": "__main__"}
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, 1):
        cell["outputs"] = run_cell("".join(cell["source"]), names, number)
        cell["execution_count"] = number


def texts(notebook: dict[str, Any]) -> list[str]:
    """Return the texts among the outputs of a notebook, and a word for each figure."""
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", ())]
    return ["".join(one["text"] if "text" in one else one["data"].get("text/plain", ["a figure"])) for one in outputs]


def alike(first: str, second: str) -> bool:
    """Return whether two texts have the same words, and numbers that differ by 2 % or one in the last place at most."""
    if NUMBER.sub("0", first) != NUMBER.sub("0", second):
        return False
    pairs = zip(NUMBER.findall(first), NUMBER.findall(second), strict=True)
    return all(
        abs(float(a) - float(b)) <= SAME * abs(float(a)) + 1.01 * 10.0 ** -len(a.partition(".")[2]) for a, b in pairs
    )


def main() -> None:
    """Run the notebooks that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+", metavar="NAME")
    parser.add_argument("--write", action="store_true", help="store the outputs")
    asked = parser.parse_args()
    os.chdir(FOLDER)
    for name in asked.names:
        path = FOLDER / name
        stored = json.loads(path.read_text("utf-8"))
        fresh = json.loads(path.read_text("utf-8"))
        run(fresh)
        if asked.write:
            path.write_text(json.dumps(fresh, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        elif [alike(*pair) for pair in zip(texts(stored), texts(fresh), strict=True)].count(False):
            print(f"{name}: another output", *texts(fresh), sep="\n")
            sys.exit(1)


if __name__ == "__main__":
    main()
