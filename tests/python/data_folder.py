"""Print the folder of this Python's packages, if the data are there that `adagio experiment` looks for."""

import sys
import sysconfig
from pathlib import Path

folder = Path(sysconfig.get_paths()["purelib"])
for package, file in [("scikit-learn", "sklearn/datasets/data/digits.csv.gz"), ("scikit-image", "skimage/data/camera.png")]:
    if not (folder / file).is_file():
        print(f"{package} is not installed", file=sys.stderr)
        sys.exit(3)
print(folder)
