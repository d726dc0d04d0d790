"""Write copies of the notebooks for a class: without the answers, with their assertions.

Each exercise keeps the assertions of its answer; they fail until the work is done. The teacher's
lesson plan and stored outputs stay in the original notebook. A folder that already contains such
notebooks is refused.
"""

from pathlib import Path

SUMMARY = "write notebooks without the answers, for students"

EPILOG = """\
example:
  mmqa student course
  mmqa student course anisotropy mimic
"""


def add_arguments(parser):
    """Declare the arguments."""
    parser.add_argument("out", type=Path, metavar="OUT_FOLDER", help="made where missing")
    parser.add_argument("name", nargs="*", metavar="NAME", help="stems of studies; all if none")


def run(options):
    """Write the copies and name them."""
    from mmqa_lab.run.students import write_student_notebooks
    from mmqa_lab.studies.catalogue import chosen

    for path in write_student_notebooks(chosen(options.name), options.out):
        print(path)
