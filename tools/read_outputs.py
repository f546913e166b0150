#!/usr/bin/env python3
"""Reads every table that snakeloop writes into a folder, with pandas, and prints what is in it.

    tools/read_outputs.py out

Needs Python 3.10 and pandas.
"""

import json
import sys
import tomllib
from pathlib import Path

import pandas as pd

INDEXED = {
    "measurements.csv",
    "estimate.csv",
    "encoders.csv",
    "truth.csv",
    "stem.csv",
    "force.csv",
    "closed_loop.csv",
    "next.csv",
}


def read(folder: Path) -> dict[str, pd.DataFrame]:
    """All CSV files of a folder by name; those with one row a frame are indexed by the frame's number."""
    tables = {}
    for path in sorted(folder.glob("*.csv")):
        table = pd.read_csv(path)
        tables[path.name] = table.set_index("index") if path.name in INDEXED else table
    journal = folder / "journal.jsonl"
    if journal.exists():
        tables[journal.name] = pd.read_json(journal, lines=True)
    return tables


def main(folder: Path) -> None:
    tables = read(folder)
    for name, table in tables.items():
        print(f"\n{name}: {len(table)} rows")
        print(table.describe(include="all").transpose().to_string(max_rows=30))

    measured = tables.get("measurements.csv")
    if measured is not None:
        good = measured[measured["status"] == "ok"]
        print(f"\n{len(good)} of {len(measured)} frames measured, median σ_θ {good['sigma_theta_deg'].median():.3f}°")

    model = folder / "model.toml"
    if model.exists():
        estimate = tomllib.loads(model.read_text()).get("estimate")
        if estimate:
            print(f"η = {estimate['eta']:.4f} ± {estimate['sd_eta']:.4f}")
            print(f"λ = {estimate['lambda_mm']:.4f} ± {estimate['sd_lambda_mm']:.4f} mm")

    compensation = tables.get("compensation.csv")
    if compensation is not None:
        swallowed = (compensation["qc1_mm"] - compensation["q1_mm"]).abs().max()
        print(f"largest correction of backbone 1: {swallowed:.3f} mm")

    for path in sorted(folder.glob("*.json")):
        print(f"{path.name}: {', '.join(json.loads(path.read_text()))}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
