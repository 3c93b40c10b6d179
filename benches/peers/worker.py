"""One peer in a process of its own: JSON requests on standard input, JSON answers on standard output.

`worker.py MODULE FOLDER`: MODULE is the file of a peer, each public function of which answers the requests of its name.
They get the folder with the data and the request's arguments, keep what they set up in `STATE`, and return a
dictionary; what is timed they time themselves with `timed`, so that loading and converting never count.
"""

import importlib
import json
import sys
import time
from pathlib import Path

STATE = {}


def timed(work):
    """What `work()` returns, and the seconds that it took."""
    begin = time.perf_counter()
    result = work()
    return result, time.perf_counter() - begin


def main():
    module, folder = sys.argv[1:]
    peer = importlib.import_module(module)
    # A library that prints must not disturb the answers.
    answers, sys.stdout = sys.stdout, sys.stderr
    for line in sys.stdin:
        request = json.loads(line)
        answer = getattr(peer, request.pop("do"))(Path(folder), **request)
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    # Peers import this file under its name; without this they would get a second STATE.
    sys.modules["worker"] = sys.modules["__main__"]
    main()
