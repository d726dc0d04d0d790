"""Metrics by their names on the command line, and those of a reader's own."""

__all__ = ["metrics_of"]


def metrics_of(text):
    """Functions of a chart by their names, from "all" or "NAME,MODULE:FUNCTION"; none for None."""
    from mmqa_lab._checks import check_known
    from mmqa_lab.commands.laboratory import named_function
    from mmqa_lab.metrics import METRICS

    if text is None:
        return {}
    found = {}
    for word in METRICS if text == "all" else text.split(","):
        if ":" in word:
            name, function = named_function(word)
        else:
            name = check_known(word.strip(), "metric", METRICS)
            function = METRICS[name]
        found[name] = function
    return found
