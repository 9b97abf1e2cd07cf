"""A page for each example, with what it draws and prints when it runs, and the gallery that leads to them."""

import ast
import hashlib
import os
import re
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jupytext
from generated import heading
from sphinx.errors import ExtensionError
from sphinx.util.display import status_iterator

# The story: chapters, and what each page is called.
STORY = {
    "The filter": {
        "01_drop_in": "One class changed",
        "03_missing_sensors": "Missing sensors",
        "02_choosing_psi": "Choosing psi",
        "04_level_shift": "A jump, or outliers in a row",
        "12_multipath_fusion": "Runs of outliers, and coming back",
        "05_imm": "An IMM that keeps its models apart",
        "06_smoothing": "Smoothing",
        "14_noise_unknown": "Noise that is unknown",
        "20_sensors_in_time": "A robot whose sensors lie",
        "13_test_your_own_filter": "A slip that no plot shows",
    },
    "Identification": {
        "17_from_recording_to_model": "A logger's file becomes a model",
        "18_choosing_the_order": "Choosing the order",
        "19_is_the_model_good": "Is the model good?",
        "21_physics_from_a_recording": "Physics from a recording",
        "07_tracking_parameters": "Parameters that drift",
        "08_input_design": "Which input tells most",
        "10_a_fleet_of_actuators": "Which actuators leak?",
    },
    "Nonlinear": {"11_radar_glint": "A radar whose echo jumps"},
    "Scale": {
        "09_many_filters": "Many filters at once",
        "15_a_fleet_on_dask": "A fleet on Dask",
        "16_in_a_stream": "In a stream",
    },
    "Studies": {
        "first_screen": "The picture of the first page",
        "water_flow": "A city's water flow",
        "state_estimation_study": "The paper's state estimation",
        "pneumatic_servo": "A pneumatic servo",
    },
}
# Beside the outputs: what they were made from.
STAMP = "made_from"
SPECIAL = re.compile(r"([\\*`|_])")


def pages(examples: Path, docs: Path) -> dict[str, str]:
    """Run the examples and return their pages and the gallery, by file name below docs."""
    titles = {stem: title for chapter in STORY.values() for stem, title in chapter.items()}
    if titles.keys() != {path.stem for path in examples.glob("*.py")}:
        raise ExtensionError(f"docs/gallery.py: STORY has other examples than {examples}")
    found, questions, figures = {}, {}, {}
    printed = outputs([examples / f"{stem}.py" for stem in titles], docs / "examples" / "outputs")
    for stem, title in titles.items():
        path, drawn = examples / f"{stem}.py", re.findall(r"(?m)^Figure: (.*)$", printed[stem])
        question, _, rest = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n\n")
        questions[stem] = " ".join(question.split())
        figures[stem] = [f"outputs/{stem}/{Path(figure).name}" for figure in drawn]
        found[f"examples/{stem}.rst"] = page(path.name, title, question, rest, figures[stem], printed[stem])
        found[f"examples/notebooks/{stem}.ipynb"] = notebook(path)
    for path in (docs / "tutorial").glob("*.md"):
        found[f"examples/notebooks/{path.stem}.ipynb"] = written(jupytext.reads(path.read_text(encoding="utf-8"), "md"))
    found["examples/index.rst"] = gallery(questions, figures)
    return found


def outputs(paths: list[Path], folder: Path) -> dict[str, str]:
    """Run the examples that have changed, or the modules that they import, and return what each printed, by name."""

    def one(path: Path) -> str:
        out = folder / path.stem
        stamp, log = out / STAMP, out / "printed.txt"
        if not stamp.exists() or stamp.read_text(encoding="utf-8") != made_from(stamp, path.parents[1]):
            out.mkdir(parents=True, exist_ok=True)
            printed, modules = run(path, out)
            log.write_text(printed, encoding="utf-8")
            sources = [path, *sources_of(modules, path.parents[1])]
            stamp.write_text(fingerprints(sources, path.parents[1]), encoding="utf-8")
        return log.read_text(encoding="utf-8")

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        printed = status_iterator(pool.map(one, paths), "running examples... ", length=len(paths), verbosity=0)
        return dict(zip((path.stem for path in paths), printed, strict=True))


def made_from(stamp: Path, root: Path) -> str:
    """Return what a stamp would be now."""
    names = [line.split("  ", 1)[1] for line in stamp.read_text(encoding="utf-8").splitlines()]
    return fingerprints([root / name for name in names], root)


def fingerprints(paths: list[Path], root: Path) -> str:
    """Return a line for each file: the hash of its content, its name."""
    found = {path: path.read_bytes() if path.exists() else b"" for path in sorted(set(paths))}
    return "\n".join(f"{hashlib.sha256(b).hexdigest()}  {path.relative_to(root)}" for path, b in found.items())


def sources_of(modules: set[str], root: Path) -> list[Path]:
    """Return the files of those modules that are the package's or the examples', the kernel's in C with them."""
    found = [root / "setup.py", *(root / "robust_filterpy" / "kernel").glob("*.[ch]")]
    for name in modules:
        for top in (root, root / "examples"):
            path = top.joinpath(*name.split("."))
            found += [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.exists()]
    return found


def run(path: Path, out: Path) -> tuple[str, set[str]]:
    """Return what an example prints, and the modules that it imports."""
    here = path.parents[1]
    search = os.pathsep.join(filter(None, (str(here), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": search, "PYTHONIOENCODING": "utf-8"}
    # The interpreter itself writes every import to stderr, its last column is the module.
    command = [sys.executable, "-X", "importtime", path, "--out", out]
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, encoding="utf-8")
    lines = done.stderr.splitlines()
    imports = [line for line in lines if line.startswith("import time:")]
    if done.returncode:
        raise ExtensionError(f"{path.name} fails:\n" + "\n".join(line for line in lines if line not in set(imports)))
    modules = {line.rpartition("|")[2].strip() for line in imports}
    return done.stdout.replace(str(out), "examples/output"), modules


def page(name: str, title: str, question: str, rest: str, figures: list[str], printed: str) -> str:
    """Return the page of an example: question, figures, conclusion, what else it prints, code."""
    table, _, conclusion = printed.partition("Conclusion")
    # The figures are on the page.
    table, conclusion = (re.sub(r"(?m)^(Figure|Data): .*\n?", "", text) for text in (table, conclusion))
    stem = Path(name).stem
    lines = [heading(title), question + "\n", rest + "\n"]
    lines += [f".. image:: {figure}\n   :alt: {title}\n   :class: figure\n" for figure in figures]
    lines += [f"**Conclusion**{escaped(' '.join(conclusion.split()))}\n"]
    if table.strip():
        lines += [heading("What it prints", "-"), ".. code-block:: text\n", indented(fitted(table.strip("\n"))), ""]
    return "\n".join(
        [
            *lines,
            heading("The program", "-"),
            f"Run ``python examples/{name}``, as this page did, or take the file, "
            f":download:`{name} <../../examples/{name}>`, or the "
            f"notebook, :download:`{stem}.ipynb <notebooks/{stem}.ipynb>`.\n",
            f".. literalinclude:: ../../examples/{name}\n   :language: python\n",
        ]
    )


def fitted(printed: str) -> str:
    """Return what was printed with long sentences on lines that the page holds; a table's columns stay."""
    return "\n".join(
        line if "  " in line.strip() else textwrap.fill(line, 90, subsequent_indent="  ", break_on_hyphens=False)
        for line in printed.splitlines()
    )


def gallery(questions: dict[str, str], figures: dict[str, list[str]]) -> str:
    """Return the page that shows a picture of each example, in the order of the story."""
    lines = [
        heading("Examples"),
        "Each asks a question, draws a figure and prints a conclusion. All pictures here were drawn when this site\n"
        "was built; a program that you run writes its figures to ``examples/output``.\n",
    ]
    for chapter, titles in STORY.items():
        lines += [heading(chapter, "-"), ".. container:: gallery\n"]
        for stem, title in titles.items():
            card = [".. container:: card\n"]
            card += [f"   .. image:: {figures[stem][0]}\n      :target: {stem}.html\n      :alt: {title}\n"]
            card += [f"   :doc:`{stem}`\n", f"   {questions[stem]}\n"]
            lines += [indented("\n".join(card)), ""]
        lines += [".. toctree::\n   :hidden:\n", *[f"   {stem}" for stem in titles], ""]
    return "\n".join(lines)


def notebook(path: Path) -> str:
    """Return an example as a notebook: a cell for each part that `# %%` begins; it runs in the folder of the examples.

    An example reads its options from the command line, which a notebook has none of.
    """
    found = jupytext.reads(path.read_text(encoding="utf-8"), fmt="py:percent")
    for cell in found.cells:
        cell.source = cell.source.replace('if __name__ == "__main__":\n    main()', "main([])")
        # A notebook does not know its file.
        cell.source = cell.source.replace("Path(__file__)", f'Path("{path.name}")')
    return written(found)


def written(notebook) -> str:
    """Return a notebook as text, the same in each build."""
    for number, cell in enumerate(notebook.cells):
        # nbformat draws these at random.
        cell["id"] = f"cell-{number}"
    return str(jupytext.writes(notebook, fmt="ipynb"))


def escaped(text: str) -> str:
    """Return text in which nothing is markup."""
    return SPECIAL.sub(r"\\\1", text)


def indented(text: str) -> str:
    """Return text three columns further right."""
    return "\n".join(f"   {line}".rstrip() for line in text.splitlines())
