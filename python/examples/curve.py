"""What the examples share: their options, and how well the agent arrives at each quarter of its steps."""

import argparse
import json

import numpy as np


def options(doc, steps, of="the agent's actions"):
    """A parser of what all examples take; `doc`: what `--help` says first."""
    parser = argparse.ArgumentParser(description=doc.split("\n")[0])
    parser.add_argument("--steps", type=int, default=steps, help=f"{of}, without those of trials ({steps:,})")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--trials", type=int, default=100, help="at each quarter (100)")
    parser.add_argument("--out", help="folder of the run")
    return parser


def curve(loop, actions, trials, repeat=1):
    """Drive for so many actions; at each quarter of them, and at their end, send the agent to its goal.

    Prints a line of JSON for each; `repeat`: steps of the environment in an action. Trials are actions of the run, too, and the
    agent goes on learning in them.
    """
    met = of_trials = 0
    for quarter in range(1, 5):
        while loop.steps - of_trials < actions * quarter // 4:
            met += loop.step()[1] > 0
        before = loop.steps
        results = loop.trials(trials)
        of_trials += loop.steps - before
        arrived = [actions for arrives, actions in results if arrives]
        print(json.dumps({"steps": repeat * (loop.steps - of_trials), "steps_of_trials": repeat * of_trials, "goals_met": met,
                          "success": len(arrived) / len(results), "mean_actions": float(np.mean(arrived or [0]))}), flush=True)
    loop.agent.close()


def most(actions, trials, longest):
    """Actions of such a run at most, if a trial has at most `longest`; an episode's end takes one more, and any may be an end."""
    return 2 * actions + 4 * trials * (longest + 1)
