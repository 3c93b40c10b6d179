#!/usr/bin/env python3
"""Optimise a pose graph with GTSAM, and print its poses and its error as JSON.

    pose_graph.py GRAPH.json

GRAPH.json: {"poses": [[x, y, heading]], "factors": [[from, to, [x, y, heading], [sigma, sigma, sigma], cauchy or null]]}.

Exit codes: 0 done; 3 a package is not installed.
"""

import json
import sys

try:
    import gtsam
    import numpy
except ImportError as missing:
    print(f"{missing} (pip install gtsam)", file=sys.stderr)
    sys.exit(3)


def between(measured):
    """The error of a factor, with derivatives by motions of both poses in their own frames.

    gtsam.BetweenFactorPose2 takes the logarithm of the difference; here it is the difference itself, as most pose-graph programs have it.
    """
    of_measured = measured.rotation().matrix().T

    def error(this, values, jacobians):
        first, second = (values.atPose2(key) for key in this.keys())
        seen = first.between(second)
        off = measured.between(seen)
        if jacobians is not None:
            to_first = numpy.array([[-1, 0, seen.y()], [0, -1, -seen.x()]])
            jacobians[0] = numpy.vstack([of_measured @ to_first, [0, 0, -1]])
            to_second = numpy.hstack([seen.rotation().matrix(), [[0], [0]]])
            jacobians[1] = numpy.vstack([of_measured @ to_second, [0, 0, 1]])
        return numpy.array([off.x(), off.y(), off.theta()])

    return error


with open(sys.argv[1], encoding="utf-8") as file:
    told = json.load(file)

graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
for key, pose in enumerate(told["poses"]):
    start.insert(key, gtsam.Pose2(*pose))
# The first pose stays where it is.
graph.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*told["poses"][0])))
for first, second, measured, sigmas, cauchy in told["factors"]:
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    if cauchy is not None:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(cauchy), noise)
    graph.add(gtsam.CustomFactor(noise, [first, second], between(gtsam.Pose2(*measured))))

parameters = gtsam.LevenbergMarquardtParams()
parameters.setMaxIterations(1000)
parameters.setRelativeErrorTol(1e-15)
parameters.setAbsoluteErrorTol(1e-15)
found = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
poses = [found.atPose2(key) for key in range(len(told["poses"]))]
print(json.dumps({"poses": [[of.x(), of.y(), of.theta()] for of in poses], "error": graph.error(found)}))
