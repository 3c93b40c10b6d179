"""Print the folder of this Python's packages, if the data are there that `adagio experiment` looks for."""

import sys
import sysconfig
from pathlib import Path

folder = Path(sysconfig.get_paths()["purelib"])
if not (folder / "sklearn/datasets/data/digits.csv.gz").is_file():
    print("scikit-learn is not installed", file=sys.stderr)
    sys.exit(3)
print(folder)
