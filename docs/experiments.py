#!/usr/bin/env python3
"""Put results of `adagio experiment` into docs/experiments.md: command, tables and pictures. What is written about them stays.

    adagio experiment all --seeds 11..13
    python3 docs/experiments.py experiments/all/001             # all of them, or
    python3 docs/experiments.py experiments/slowness/002        # one
"""

import json
import pathlib
import re
import shutil
import sys

DOCS = pathlib.Path(__file__).parent
PAGE = DOCS / "experiments.md"
# Long tables that stand in `table.md` alone, by the beginning of their titles.
LEFT_OUT = ["Steps of each trajectory", "All policies"]


def command(result):
    """The command that gives such results."""
    seeds = result["seeds"]
    words = ["adagio experiment", result["experiment"]]
    words += [f"--{result['size']}"] if result["size"] != "full" else []
    words += [f"--vectors {result['vectors']}"] if result["vectors"] else []
    if seeds != [11]:  # the default
        whole = len(seeds) > 1 and seeds == list(range(seeds[0], seeds[-1] + 1))
        words.append(f"--seeds {seeds[0]}..{seeds[-1]}" if whole else f"--seeds {','.join(map(str, seeds))}")
    return " ".join(words)


def filled(page, folder):
    """The page with the results of one experiment in its section."""
    result = json.loads((folder / "result.json").read_text())
    name = result["experiment"]
    section = re.search(rf"^## `{re.escape(name)}`\n.*?(?=^## |\Z)", page, re.M | re.S)
    if not section:
        sys.exit(f"{PAGE} has no section `{name}`")
    old = section[0]
    # The comment beside the command says how long it takes.
    text, found = re.subn(rf"^adagio experiment {re.escape(name)}\b[^#\n]*?(?=\s*#|\s*$)", command(result), old, count=1, flags=re.M)
    if not found:
        sys.exit(f"{PAGE}: the section `{name}` has no command")
    table = (folder / "table.md").read_text()
    table = re.sub(r"^!\[.*\n", "", table[table.index("**") :], flags=re.M)
    for title in LEFT_OUT:
        table = re.sub(rf"^\*\*{title}.*\n\n(\|.*\n)*", "", table, flags=re.M)
    table = re.sub(r"\n{3,}", "\n\n", table).strip()
    text = text[: text.index("\n**") + 1] + table + "\n\n"
    for picture in re.findall(rf"\]\(experiments/({re.escape(name)}-[^)]+)\)", text):
        shutil.copyfile(folder / picture.removeprefix(f"{name}-"), DOCS / "experiments" / picture)
    return page.replace(old, text)


def main():
    folders = [found.parent for given in sys.argv[1:] for found in sorted(pathlib.Path(given).glob("**/result.json"))]
    if not folders:
        sys.exit(__doc__)
    page = PAGE.read_text()
    for folder in folders:
        page = filled(page, folder)
    PAGE.write_text(page.rstrip() + "\n")


if __name__ == "__main__":
    main()
