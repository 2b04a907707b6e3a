"""Which models a benchmark looks at, and where its figures go."""

import argparse
import json
from pathlib import Path


def publish(result: object, output: Path | None) -> None:
    """Prints figures as JSON and writes them to a file, if there is to be one."""
    text = json.dumps(result, indent=1)
    print(text)
    if output:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text + "\n")


def of_official_models(what: str | None) -> argparse.Namespace:
    """Options of benchmarks that look at models of the official code: `data`, `models` and `output`."""
    parser = argparse.ArgumentParser(description=what, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--models", nargs="+", default=["snowmiku_small_2400", "snowmiku_15k", "bonsai_30k"])
    parser.add_argument("--output", type=Path)
    return parser.parse_args()
