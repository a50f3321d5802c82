"""Records the figures of a run that the documents print. tests/docs/figures_test.py compares them.

usage: record.py summary.json|study.csv FILE       for example: record.py out/pusher/summary.json docs/recorded/pusher.json
"""
import csv
import json
import pathlib
import sys


def record(source, target):
    if source.suffix == ".csv":
        with source.open(newline="") as file:
            rows = list(csv.DictReader(file))
        with target.open("w", newline="") as file:
            out = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            out.writeheader()
            kept = ("alone", "guard", "controller", "placebo-corrections")
            out.writerows(row for row in rows if row["method"] in kept)
        return
    summary = json.loads(source.read_text())
    kept = {key: summary[key] for key in ("experiment", "preset", "commit", "seed", "averages", "contrasts")}
    # Times of other machines are not comparable.
    for row in kept["averages"] + kept["contrasts"]:
        for key in [key for key in row if "seconds" in key]:
            del row[key]
    target.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    record(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
