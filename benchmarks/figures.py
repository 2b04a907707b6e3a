"""Output of a benchmark's figures."""

import json
from pathlib import Path


def publish(result: object, output: Path | None) -> None:
    """Prints figures as JSON, and writes them to a file if one is given."""
    text = json.dumps(result, indent=1)
    print(text)
    if output:
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text + "\n")
