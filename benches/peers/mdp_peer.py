"""SFA of the Modular toolkit for Data Processing (MDP) on our kernel rows."""

import mdp
import numpy as np

from worker import timed


def sfa(folder, k):
    rows = np.load(folder / "rows.npy")
    node = mdp.nodes.SFANode(output_dim=k)

    def work():
        node.train(rows)
        node.stop_training()

    _, seconds = timed(work)
    return {"seconds": seconds, "slowness": [float(value) for value in node.d[:k]]}
