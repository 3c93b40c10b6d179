//! Frames of the simulated robot on a random walk, for the benches that shall see what the agent sees.

use std::path::Path;
use std::sync::Arc;

use adagio::policy::{Recent, Reflexes, Walk};
use adagio::random;
use adagio::robot::{Action, Pose};
use adagio::scenario::Scenario;
use adagio::slow::Link;
use adagio::source::{Frame, Source};
use adagio::vision::observe;
use adagio::world::Simulated;
use adagio::world::World;
use faer::Mat;
use nalgebra::{Point2, Vector2};

/// A scenario of the repository, with overrides `KEY=VALUE`.
pub fn scenario(name: &str, sets: &[&str]) -> Arc<Scenario> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(name);
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    Arc::new(Scenario::load(&path, &sets).unwrap_or_else(|error| panic!("{error}")))
}

/// The robot of the lab, exploring by its random walk.
pub struct Walker {
    scenario: Arc<Scenario>,
    source: Simulated,
    walk: Walk,
    /// The newest boundary: what the walk chooses by.
    last: Frame,
}

/// Observations, one a column, and how each follows the one before it.
pub struct Frames {
    pub x: Mat<f32>,
    pub links: Vec<Option<Link>>,
}

impl Walker {
    /// The lab's robot at its start pose.
    pub fn new() -> Self {
        let scenario = scenario("lab.toml", &[]);
        let world = Arc::new(World::new(&scenario).expect("a scenario without image files"));
        let mut source = Simulated::new(scenario.clone(), world);
        let walk = Walk::new(&scenario, random::stream(scenario.seed, "explore"));
        let last = source.first().expect("a robot has a first frame");
        Walker { source, walk, last, scenario }
    }

    /// The next `n` frames.
    pub fn frames(&mut self, n: usize) -> Frames {
        let scenario = self.scenario.clone();
        let reflexes = Reflexes::new(&scenario);
        let d = 3 * scenario.vision.width * scenario.vision.height;
        let (mut x, mut links) = (Mat::zeros(d, n), Vec::with_capacity(n));
        while links.len() < n {
            let blocked = self.last.boundary.as_ref().is_some_and(|boundary| boundary.blocked);
            let after = |action| Recent::default().then(action, blocked, &scenario.robot.actions);
            let recent = self.last.action.map_or(Recent::default(), after);
            let action = self.walk.choose(&self.last.sonar, reflexes, recent);
            let weight = if action == Action::FORWARD { scenario.slow.move_weight } else { 1.0 };
            let last = &mut self.last;
            self.source.execute(action, &mut |frame| {
                let observation =
                    observe(frame.view.image().expect("a simulated image"), &scenario.vision, frame.number);
                for (entry, value) in x.col_mut(links.len()).iter_mut().zip(observation.values()) {
                    *entry = value;
                }
                links.push(Some(Link { dt: scenario.robot.frame_seconds(), weight }));
                if frame.boundary.is_some() {
                    *last = frame;
                }
                links.len() < n
            });
        }
        Frames { x, links }
    }
}

/// Poses all over the room of the lab, so that no view is measured alone.
pub fn poses(scenario: &Scenario) -> Vec<Pose> {
    let centre = Point2::from(scenario.robot.start);
    (0..64)
        .map(|i| {
            let angle = f64::from(i) * 2.4; // about the golden angle: directions all around
            let radius = 0.6 * f64::from(i) / 64.0;
            Pose::new(centre + Vector2::new(angle.cos(), angle.sin()) * radius, 1.7 * angle)
        })
        .collect()
}
