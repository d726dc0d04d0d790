"""List the public names of the library: room, name, and what it is for in a line.

With WORD only those in which it occurs. What a name takes and gives back, its units, errors and
source: help(mmqa_lab.ROOM.NAME) in Python, or NAME? in a notebook.
"""

from mmqa_lab.commands._output import add_output_arguments, print_rows

SUMMARY = "list the public names of the library"

EPILOG = """\
example:
  mmqa names
  mmqa names density --json
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("word", nargs="?", default="", metavar="WORD", help="all names if none")
    add_output_arguments(parser)


def run(options):
    """Print the names and write them where asked for."""
    from mmqa_lab import names

    print_rows(names.table(options.word), options)
