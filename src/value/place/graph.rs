//! A pose graph in the plane: poses, and measured poses of some as seen from others; its least-squares optimum.
//!
//! Minimised is `Σ ρ(χ²)` over all factors, with `χ² = Σ (eₖ/σₖ)²` and `e` the pose of the second node as seen from where the factor
//! expects it: two coordinates and an angle. `ρ` is the identity, or Cauchy's `c² ln(1 + χ²/c²)`, which makes a factor that
//! contradicts all others count little. Each step solves the damped normal equations (Levenberg & Marquardt) by faer's sparse
//! Cholesky factorisation; the first pose stays where it is, since nothing else tells where the graph lies.
//!
//! # Units
//! One length for all, and radians.
//!
//! # Reference
//! Lu & Milios 1997; Kümmerle et al. 2011 (the normal equations of a graph); Agarwal et al. 2013 (weights against wrong closures).

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use thiserror::Error;

use super::Pose;

/// Damping at first, as a share of the diagonal, and by what it falls or grows with each step.
const DAMPING: (f64, f64) = (1e-6, 10.0);
/// With more damping than this no step makes it better: what is left is rounding.
const MOST_DAMPING: f64 = 1e8;

/// Where one node is as seen from another, measured.
#[derive(Debug, Clone, Copy)]
pub struct Factor {
    /// The node from which it is seen.
    pub from: usize,
    /// The other node.
    pub to: usize,
    /// Pose of `to` in the frame of `from`.
    pub measured: Pose,
    /// Standard deviations ahead, aside and of the heading, in the frame of `measured`.
    pub sigmas: [f64; 3],
    /// Cauchy's `c`, in standard deviations; none: least squares.
    pub cauchy: Option<f64>,
}

/// Poses and what is known of them.
#[derive(Debug, Clone)]
pub struct PoseGraph {
    poses: Vec<Pose>,
    factors: Vec<Factor>,
}

/// What optimising came to.
#[derive(Debug, Clone, Copy)]
pub struct Optimum {
    /// The sum that was minimised.
    pub cost: f64,
    /// Steps that made it better.
    pub steps: usize,
    /// Whether the last step was below the tolerance.
    pub converged: bool,
}

/// Why a graph has no optimum.
#[derive(Debug, Error)]
pub enum GraphError {
    /// A factor of a node that there is not, or between a node and itself.
    #[error("factor {factor} joins node {from} to node {to}; nodes are 0 to {nodes}, less one, and have to differ")]
    Node {
        /// Number of the factor.
        factor: usize,
        /// Its first node.
        from: usize,
        /// Its second node.
        to: usize,
        /// Number of nodes.
        nodes: usize,
    },
    /// A number that is none, or a standard deviation that is not above 0.
    #[error("{0} is not finite, or has a standard deviation or a Cauchy width that is not above 0")]
    Number(String),
    /// The normal equations cannot be solved.
    #[error(
        "the normal equations of {nodes} nodes and {factors} factors cannot be solved ({cause}): does a way of factors lead to each node?"
    )]
    Solve {
        /// Number of nodes.
        nodes: usize,
        /// Number of factors.
        factors: usize,
        /// What the decomposition says.
        cause: String,
    },
}

impl PoseGraph {
    /// Poses to begin with, and factors between them.
    ///
    /// # Errors
    /// [`GraphError::Node`], [`GraphError::Number`].
    pub fn new(poses: Vec<Pose>, factors: Vec<Factor>) -> Result<Self, GraphError> {
        let is_finite = |pose: &Pose| [pose.x, pose.y, pose.heading].iter().all(|number| number.is_finite());
        if let Some(node) = poses.iter().position(|pose| !is_finite(pose)) {
            return Err(GraphError::Number(format!("node {node}")));
        }
        for (number, factor) in factors.iter().enumerate() {
            let &Factor { from, to, measured, sigmas, cauchy } = factor;
            if from.max(to) >= poses.len() || from == to {
                return Err(GraphError::Node { factor: number, from, to, nodes: poses.len() });
            }
            let above = |value: f64| value.is_finite() && value > 0.0;
            if !is_finite(&measured) || !sigmas.into_iter().chain(cauchy).all(above) {
                return Err(GraphError::Number(format!("factor {number}")));
            }
        }
        Ok(PoseGraph { poses, factors })
    }

    /// The poses.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// The sum that is minimised.
    pub fn cost(&self) -> f64 {
        self.cost_at(&self.poses)
    }

    fn cost_at(&self, poses: &[Pose]) -> f64 {
        self.factors.iter().map(|factor| factor.loss(factor.error(poses)).0).sum()
    }

    /// Move all poses but the first to where the sum is least: at most so many steps, until one moves no pose by more than `tolerance`.
    /// It is the optimum next to where they began.
    ///
    /// # Errors
    /// [`GraphError::Solve`].
    pub fn optimise(&mut self, most: usize, tolerance: f64) -> Result<Optimum, GraphError> {
        let n = 3 * self.poses.len().saturating_sub(1);
        let mut found = Optimum { cost: self.cost(), steps: 0, converged: n == 0 };
        let (mut damping, mut symbolic) = (DAMPING.0, None);
        while !found.converged && found.steps < most {
            let (triplets, gradient) = self.linearised();
            let mut diagonal = vec![0.0; n];
            triplets.iter().filter(|of| of.row == of.col).for_each(|of| diagonal[of.row] += of.val);
            loop {
                let damped = diagonal.iter().enumerate().map(|(i, &of)| Triplet::new(i, i, damping * of));
                let all: Vec<_> = triplets.iter().copied().chain(damped).collect();
                // Nodes that nothing ties to the first one have no place of their own: damping alone keeps them where they are.
                let step = match self.solve(&all, &gradient, &mut symbolic) {
                    Err(_) if damping <= MOST_DAMPING => {
                        damping *= DAMPING.1;
                        continue;
                    }
                    step => step?,
                };
                let moved: Vec<Pose> =
                    self.poses.iter().enumerate().map(|(node, pose)| shifted(pose, node, &step)).collect();
                let cost = self.cost_at(&moved);
                let size = step.col(0).iter().fold(0.0f64, |size, of| size.max(of.abs()));
                if cost <= found.cost {
                    self.poses = moved;
                    found = Optimum { cost, steps: found.steps + 1, converged: size <= tolerance };
                    damping = (damping / DAMPING.1).max(f64::EPSILON);
                    break;
                }
                damping *= DAMPING.1;
                // A small step that is worse by rounding alone is as good as none.
                found.converged = size <= tolerance;
                if found.converged || damping > MOST_DAMPING {
                    return Ok(found);
                }
            }
        }
        Ok(found)
    }

    /// Lower triangle of the normal equations' matrix, `n × n` with `n = 3 (N − 1)`, and the gradient, `n`.
    fn linearised(&self) -> (Vec<Triplet<usize, usize, f64>>, Vec<f64>) {
        let mut gradient = vec![0.0; 3 * self.poses.len().saturating_sub(1)];
        let mut triplets = Vec::with_capacity(21 * self.factors.len());
        for factor in &self.factors {
            let error = factor.error(&self.poses);
            let jacobians = factor.jacobians(&self.poses);
            let weight = factor.loss(error).1;
            let information = factor.sigmas.map(|sigma| weight / (sigma * sigma));
            let nodes = [(factor.from, jacobians[0]), (factor.to, jacobians[1])];
            for (node, of) in nodes.into_iter().filter(|of| of.0 > 0) {
                let row = 3 * (node - 1);
                for i in 0..3 {
                    gradient[row + i] += (0..3).map(|k| of[k][i] * information[k] * error[k]).sum::<f64>();
                }
                for (other, with) in nodes.into_iter().filter(|of| of.0 > 0) {
                    let column = 3 * (other - 1);
                    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                        if row + i >= column + j {
                            let value = (0..3).map(|k| of[k][i] * information[k] * with[k][j]).sum();
                            triplets.push(Triplet::new(row + i, column + j, value));
                        }
                    }
                }
            }
        }
        (triplets, gradient)
    }

    /// The step; the pattern of the matrix stays the same, so it is analysed once.
    fn solve(
        &self,
        triplets: &[Triplet<usize, usize, f64>],
        gradient: &[f64],
        symbolic: &mut Option<SymbolicLlt<usize>>,
    ) -> Result<Mat<f64>, GraphError> {
        let failed = |cause: String| GraphError::Solve { nodes: self.poses.len(), factors: self.factors.len(), cause };
        let n = gradient.len();
        let matrix =
            SparseColMat::try_new_from_triplets(n, n, triplets).map_err(|cause| failed(format!("{cause:?}")))?;
        let analysed = match symbolic.take() {
            Some(known) => known,
            None => {
                SymbolicLlt::try_new(matrix.symbolic(), Side::Lower).map_err(|cause| failed(format!("{cause:?}")))?
            }
        };
        *symbolic = Some(analysed.clone());
        let factorised = Llt::try_new_with_symbolic(analysed, matrix.as_ref(), Side::Lower);
        let factorised = factorised.map_err(|cause| failed(format!("{cause:?}")))?;
        let step = factorised.solve(Mat::from_fn(n, 1, |i, _| -gradient[i]));
        if step.is_all_finite() { Ok(step) } else { Err(failed("it is singular".into())) }
    }
}

impl Factor {
    /// Where `to` is from where it is expected: ahead, aside, angle.
    fn error(&self, poses: &[Pose]) -> [f64; 3] {
        let seen = poses[self.to].seen_from(&poses[self.from]).seen_from(&self.measured);
        [seen.x, seen.y, seen.heading]
    }

    /// Derivatives of the error by x, y and heading of both nodes: rows are those of the error.
    fn jacobians(&self, poses: &[Pose]) -> [[[f64; 3]; 3]; 2] {
        let (from, to) = (&poses[self.from], &poses[self.to]);
        let (sin, cos) = (from.heading + self.measured.heading).sin_cos();
        let (x, y) = (to.x - from.x, to.y - from.y);
        // With φ = θ + θ_measured: e = Rᵀ(φ)(t₂ − t₁) − const.
        let by_heading = [-sin * x + cos * y, -cos * x - sin * y];
        let of_to = [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]];
        let of_from = [[-cos, -sin, by_heading[0]], [sin, -cos, by_heading[1]], [0.0, 0.0, -1.0]];
        [of_from, of_to]
    }

    /// What an error costs, and its weight in the normal equations.
    fn loss(&self, error: [f64; 3]) -> (f64, f64) {
        let squared: f64 = error.iter().zip(self.sigmas).map(|(error, sigma)| (error / sigma).powi(2)).sum();
        match self.cauchy {
            Some(c) => (c * c * (squared / (c * c)).ln_1p(), 1.0 / (1.0 + squared / (c * c))),
            None => (squared, 1.0),
        }
    }
}

/// The pose of a node behind a step, `3 (N − 1) × 1`; the first one stays.
fn shifted(pose: &Pose, node: usize, step: &Mat<f64>) -> Pose {
    if node == 0 {
        return *pose;
    }
    let at = |i: usize| step[(3 * (node - 1) + i, 0)];
    Pose { x: pose.x + at(0), y: pose.y + at(1), heading: pose.heading + at(2) }
}
