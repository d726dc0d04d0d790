"""What all commands share: registration, outputs, tables as text, errors in one sentence.

:func:`table` registers a command and adds ``--json``, ``--csv`` and ``--report``. :func:`run`
states each error in one sentence.
"""

import functools
import inspect
import io
import os
import re
import sys
import textwrap
import warnings
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from mmqa_lab import __version__
from mmqa_lab._checks import check_outputs, is_file
from mmqa_lab._progress import progress

__all__ = [
    "FIGURE_ENDINGS", "app", "as_json", "as_text", "check_ending", "each_file", "heard",
    "run", "say_shown", "sentence_of", "table", "write_figure",
]  # fmt: skip

# Columns of a terminal that tables fit into.
WIDTH = 100

FIGURE_ENDINGS = (".pdf", ".png", ".svg")

ABOUT = """The quality of mobile mapping point clouds and images.

Evaluate your own data, run studies of published metrics, or open the notebooks.

The exit status is 0 if all is done, 1 if a file, study or test failed, 2 if nothing could be done,
130 if interrupted.
"""

app = App(
    "mmqa",
    help=ABOUT,
    version=__version__,
    help_format="markdown",
    default_parameter=Parameter(negative=()),
    suppress_keyboard_interrupt=False,
)

SHARED = {
    "json": (bool, False, "Print a JSON list of rows, with null where not measurable."),
    "csv": (Path | None, None, "Write the rows into this CSV file, too."),
    "report": (Path | None, None, "Write a page (.html) with rows, remarks and hashes of files."),
}


def table(function):
    """Register a command that prints its table; the function itself stays as it is."""

    @functools.wraps(function)
    def command(*files, json=False, csv=None, report=None, **choices):
        inputs = _inputs([*files, *choices.values()], choices.get("out"))
        check_ending(csv, "file", (".csv",))
        check_ending(report, "file", (".html",))
        check_outputs([one for one in (csv, report, choices.get("out")) if one], inputs)
        frame, said = heard(function, *files, **choices)
        if isinstance(frame, Exception) or frame.empty:
            for sentence in said:
                _say(function.__name__.rstrip("_"), sentence)
        elif said:
            told = [*(frame["remarks"].fillna("") if "remarks" in frame else [""] * len(frame))]
            frame = frame.assign(remarks=[" ".join([*said, told[0]]).strip(), *told[1:]])
        if isinstance(frame, Exception):
            raise frame
        if csv is not None:
            from mmqa_lab.io import write_atomically

            write_atomically(csv, frame)
        if report is not None:
            _write_report(report, function.__name__, frame, inputs, choices.get("out"))
        print(as_json(frame) if json else as_text(frame))
        return frame.attrs.get("status", 0)

    app.command(_with_shared(command, function), name=function.__name__.rstrip("_"))
    return function


def _with_shared(command, function):
    """A command that shows the parameters of its function and the options of all tables."""
    only = inspect.Parameter.KEYWORD_ONLY
    shared = [
        inspect.Parameter(name, only, default=one, annotation=Annotated[kind, Parameter(help=text)])
        for name, (kind, one, text) in SHARED.items()
    ]
    signature = inspect.signature(function)
    command.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *shared])
    annotations = {one.name: one.annotation for one in shared}
    command.__annotations__ = annotations | function.__annotations__
    del command.__wrapped__
    return command


def heard(function, *arguments, **choices):
    """What a function returns, or the error that it raises, and the sentences that it warns of."""
    said = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_, **__: said.setdefault(str(message))
        try:
            found = function(*arguments, **choices)
        except Exception as error:
            found = error
    return found, [*said]


def each_file(files, unit, measured, *, column="file"):
    """Tables of files below each other; a file that fails has a row with the reason alone."""
    import pandas as pd

    tables, errors, lost = [], [], []
    for file in progress(files, unit) if len(files) > 1 else files:  # a bar takes .1 s to import
        table, said = heard(measured, file)
        if isinstance(table, Exception):
            errors, lost = [*errors, table], [*lost, *said]
            table = pd.DataFrame([{"remarks": sentence_of(table, file)}])
        own = table["remarks"].fillna("") if "remarks" in table else [""] * len(table)
        told = [sentence.removeprefix(f"{file}: ") for sentence in said]
        table["remarks"] = [" ".join([*(s for s in told if s not in o), o]).strip() for o in own]
        table.insert(0, column, file.name)
        tables.append(table)
    if len(errors) == len(files) == 1:
        for sentence in lost:
            warnings.warn(sentence, stacklevel=2)
        raise ValueError(sentence_of(errors[0], files[0])) from errors[0]
    whole = pd.concat(tables, ignore_index=True)
    whole.attrs["status"] = 2 if len(errors) == len(files) else int(len(errors) > 0)
    return whole


def _inputs(given, out):
    """The texts and paths that a command was given, other than its output."""
    listed = [one for value in given for one in (value if isinstance(value, list) else [value])]
    return [str(one) for one in listed if one is not out and isinstance(one, str | Path)]


def _write_report(page, command, frame, inputs, out):
    """Write rows, remarks and the figure of a command as a page, with hashes of the files read."""
    from mmqa_lab.run.pages import write_report

    rows = frame.drop(columns="remarks", errors="ignore").dropna(axis=1, how="all")
    if len(rows) < 4 and len(rows.columns) > 9:  # a page is narrow
        rows = rows.set_index(rows.columns[0]).T.reset_index(names="")
    write_report(
        page,
        title=f"mmqa {command.rstrip('_')}",
        sentences=_sentences(frame, "remarks"),
        tables={"Results": rows},
        figures={out.name: out} if out is not None and out.suffix == ".png" else {},
        files=[one for one in inputs if is_file(one)],
    )


def run(arguments):
    """Run a command line and return its exit status."""
    words = _with_negatives(arguments)
    name = words[0] if words and not words[0].startswith("-") else ""
    if sys.stderr is None:  # closed, as by 2>&-
        sys.stderr = io.StringIO()
    for stream in (sys.stdout, sys.stderr):  # what it cannot write, as an umlaut, becomes ?
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    warnings.showwarning = lambda message, *_, **__: _say(name, message)
    try:
        status = app(words, exit_on_error=False, print_error=False, result_action="return_value")
        print(end="", flush=True)  # nothing where there is no output, as in a service
        return status if isinstance(status, int) else 0
    except (BrokenPipeError, SystemExit):  # as in: mmqa info *.laz | head; of --help by rich
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        _say(name, "interrupted; what was finished is kept.")
        return 130
    except Exception as error:
        if "--raise" in words and not isinstance(error, CycloptsError):
            raise
        _say(name, sentence_of(error, " ".join(words[1:])))
        return 2


def _with_negatives(words):
    """The words of a command line; a value such as -0.5,1,2 is joined to its option by =."""
    joined = []
    for word in words:
        if re.match(r"-\.?\d", word) and joined and re.fullmatch(r"--[\w-]+", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def sentence_of(error, given):
    """The sentence of an error; of one that nobody foresaw our own, on the ``given`` input."""
    text = " ".join(str(error).split())
    backend = os.environ.get("MPLBACKEND", "").removeprefix("module://")
    if backend and backend in text and (isinstance(error, ImportError) or "backend" in text):
        return f"Invalid MPLBACKEND {backend}. Must name an installed module, or be agg."
    if isinstance(error, CycloptsError):
        return _call_sentence(error, text)
    if isinstance(error, ImportError | OSError) or text.startswith(("Invalid", "Missing")):
        return text
    if isinstance(error, MemoryError):
        return f"Invalid input {given}: it needs more memory than there is. Must be smaller."
    return f"Invalid input {given}: no figures can be had from it. Must be as --help says."


def _call_sentence(error, text):
    """The sentence of a command line that does not fit to its command."""
    token, kind = getattr(error, "token", None), type(error).__name__
    if kind == "UnusedCliTokensError":
        found, must = f"arguments {' '.join(error.unused_tokens)}", "left out, or joined by commas"
    elif kind == "CoercionError" and token is not None:
        found = f"{token.keyword or 'argument'} {token.value}"
        must = {bool: "yes or no", int: "a whole number", float: "a number"}.get(
            error.target_type, "as --help says"
        )
    elif kind == "MissingArgumentError":
        found = f"command without {error.keyword or error.argument.name}"
        must = "complete; see --help"
    elif kind == "UnknownOptionError":
        near = text.partition("Did you mean ")[2].rstrip("?")
        found = f"option {token.keyword or token.value}"
        must = f"one of --help{f', perhaps {near}' if near else ''}"
    else:
        found, must = f"command line: {text.rstrip('.')}", "as --help says"
    return f"Invalid {found}. Must be {must}."


def _say(command, sentence):
    """Print a sentence on stderr."""
    print(f"mmqa {command}".strip() + f": {sentence}", file=sys.stderr)


def as_json(frame):
    """A table as JSON: a list with an object for each row."""
    # of a file's name some bytes may be no letters
    texts = frame.select_dtypes(exclude=["number", "bool", "datetime"])
    plain = texts.map(
        lambda one: one.encode(errors="replace").decode() if isinstance(one, str) else one
    )
    return frame.assign(**plain).to_json(orient="records", indent=1, double_precision=15)


def as_text(frame):
    """A table as text of at most 100 columns, with each remark once below it."""
    from mmqa_lab._results import printed

    if frame.empty:
        return f"{' '.join(frame.columns)}\nnone"
    below = [*_sentences(frame, "remarks")]
    frame = frame.drop(columns="remarks", errors="ignore").replace("", None)
    if "missing" in frame and not frame["missing"].any():
        frame = frame.drop(columns="missing")
    frame = frame.dropna(axis=1, how="all")
    for name in frame.columns[1:]:
        if frame[name].astype(str).str.len().max() > WIDTH / 2:
            below = [*_sentences(frame, name), *below]
            frame = frame.drop(columns=name)
    first = frame.columns[0]
    if below and len(frame.columns) == 1:  # of no file there is a figure
        return "\n".join(textwrap.fill(line, WIDTH - 1) for line in below)
    shown = printed(frame).set_index(first).rename_axis(index=None, columns=first)
    text = shown.to_string(na_rep="")
    if len(text.splitlines()[0]) > WIDTH:
        upright = shown.T.rename_axis(index=None, columns="")
        text = (upright if len(shown) <= 6 else shown).to_string(line_width=WIDTH, na_rep="")
    return "\n".join([text, *(textwrap.fill(line, WIDTH - 1) for line in below)])


def _sentences(frame, column):
    """The texts of a column, each once for a file, behind its name."""
    if column not in frame:
        return []
    names = frame["file"] + ": " if "file" in frame and len(frame) > 1 else [""] * len(frame)
    told = {}
    for name, text in zip(names, frame[column].fillna(""), strict=True):
        for one in told.setdefault(name, {}):
            text = text.removesuffix(one).rstrip()
        told[name] |= {text: None} if text else {}
    label = "" if column == "remarks" else f"{column}: "
    return [f"{name}{label}{text}" for name, texts in told.items() for text in texts]


def check_ending(path, name, endings):
    """Raise before any work if an output has a wrong ending."""
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"Invalid {name} {path}. Must end in {', '.join(endings)}.")


def say_shown(path, frame):
    """Warn where a figure is not of the last file, because that one failed."""
    figures = frame.drop(columns=["file", "remarks"], errors="ignore")
    shown = frame["file"][figures.notna().any(axis=1)].iloc[-1]
    if shown != frame["file"].iloc[-1]:
        warnings.warn(f"{path} shows {shown}.", stacklevel=2)


def write_figure(path, draw):
    """Draw in the package's style and write the figure."""
    from mmqa_lab import plots
    from mmqa_lab.io import write_atomically

    with plots.style():
        figure = draw()
        plots.finish_figure(figure)
        write_atomically(path, lambda file: figure.savefig(file))
