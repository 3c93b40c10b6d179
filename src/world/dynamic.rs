//! A robot with a mass, motors and wheels that slip, and things that it can push.
//!
//! Each motor turns its wheel as fast as it is told, with a force that is limited by the motor and by what the floor takes; the
//! wheel is faster than the floor by a creep that grows with that force, and spins freely beyond it. Sideways the wheels hold as
//! far as the floor lets them. Odometry counts the turns of the wheels: where they slip it is wrong, and where the motors stall
//! against a wall it stands still. Contacts are rapier's, in steps of 5 ms.

use nalgebra::{Point2, Vector2};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rapier2d::prelude::{ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, Vector};

use crate::robot::{Odometry, Pose, Velocity};
use crate::scenario::{BodySettings, Movable, Scenario, plan_segments};
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Seconds of a step.
pub const STEP: f64 = 0.005;

/// A base stops by itself this long after the last command, seconds.
const COMMAND_HOLDS: f64 = 0.5;

/// Acceleration of gravity, m/s².
const GRAVITY: f64 = 9.81;

/// Time in which a motor makes up for a difference in speed that its force allows, seconds.
const MOTOR_SECONDS: f64 = 0.02;

/// Distance between the wheels as a share of the robot's diameter.
const TRACK: f64 = 0.8;

/// Bodies slide along walls and each other with this friction.
const CONTACT_FRICTION: f32 = 0.2;

/// Something round that moves, in rapier's precision.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Disc {
    /// x, y, angle.
    place: [f32; 3],
    /// x, y, angle, per second.
    velocity: [f32; 3],
}

/// What rapier knows of a body.
pub struct Contacts {
    physics: PhysicsWorld,
    robot: RigidBodyHandle,
    things: Vec<RigidBodyHandle>,
}

/// The robot and the things that it can push.
#[derive(Debug, Clone)]
pub struct Dynamic {
    settings: BodySettings,
    movables: Vec<Movable>,
    walls: Vec<(Point2<f64>, Point2<f64>)>,
    radius: f64,
    robot: Disc,
    things: Vec<Disc>,
    /// Odometry's pose, and how fast the wheels turn.
    odometry: Odometry,
    command: Velocity,
    /// Seconds since the last command.
    commanded: f64,
    /// What the motors are after.
    target: Velocity,
    /// What odometry counts for a metre of each wheel.
    wheels: [f64; 2],
    /// Standard deviation of what odometry counts in a step, as a share.
    noise: f64,
    random: ChaCha8Rng,
    /// Whether something presses against its front.
    touched: bool,
}

impl Dynamic {
    /// The robot of a scenario, standing at a pose, with the things at their places; `random` draws the errors of its odometry.
    pub fn new(
        scenario: &Scenario,
        settings: &BodySettings,
        start: Pose,
        things: &[[f64; 2]],
        mut random: ChaCha8Rng,
    ) -> Self {
        let wheels = [(); 2].map(|()| 1.0 + settings.wheel_error * random.sample::<f64, _>(StandardNormal));
        let Pose { position, heading } = start;
        let disc = |x: f64, y: f64, angle: f64| Disc { place: [x as f32, y as f32, angle as f32], velocity: [0.0; 3] };
        Dynamic {
            settings: settings.clone(),
            movables: scenario.world.movables.clone(),
            walls: scenario.world.walls.iter().flat_map(plan_segments).collect(),
            radius: scenario.robot.radius,
            robot: disc(position.x, position.y, heading),
            things: things.iter().map(|&[x, y]| disc(x, y, 0.0)).collect(),
            odometry: Odometry { pose: start, velocity: Velocity::ZERO },
            command: Velocity::ZERO,
            commanded: COMMAND_HOLDS,
            target: Velocity::ZERO,
            wheels,
            // The scenario has the error of a frame.
            noise: scenario.robot.odometry_noise * (scenario.robot.frame_seconds() / STEP).sqrt(),
            random,
            touched: false,
        }
    }

    /// Where it is.
    pub fn pose(&self) -> Pose {
        let [x, y, angle] = self.robot.place.map(f64::from);
        Pose::new(Point2::new(x, y), angle)
    }

    /// Where its odometry believes it to be, and how fast it goes by that.
    pub fn odometry(&self) -> Odometry {
        self.odometry
    }

    /// Whether something presses against its front.
    pub fn is_touched(&self) -> bool {
        self.touched
    }

    /// Where each movable thing is.
    pub fn things(&self) -> impl Iterator<Item = (Point2<f64>, &Movable)> {
        let place = |disc: &Disc| Point2::new(f64::from(disc.place[0]), f64::from(disc.place[1]));
        self.things.iter().map(place).zip(&self.movables)
    }

    /// Drive like this until the next command.
    pub fn command(&mut self, velocity: Velocity) {
        (self.command, self.commanded) = (velocity, 0.0);
    }

    /// Let a step pass, among contacts that were made for this body.
    pub fn step(&mut self, contacts: &mut Contacts) {
        let Contacts { physics, robot, things } = contacts;
        self.drive(physics, *robot);
        self.slow_down(physics, things);
        physics.step();
        self.robot = disc_of(physics, *robot);
        for (disc, &handle) in self.things.iter_mut().zip(&*things) {
            *disc = disc_of(physics, handle);
        }
        self.touched = self.is_pressed(physics, *robot);
    }

    /// The bodies and walls as rapier has them. What contacts remember is not saved: they are made anew at times that the
    /// saving of a run does not change.
    pub fn contacts(&self) -> Contacts {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::ZERO;
        physics.integration_parameters.dt = STEP as f32;
        let single = |point: &Point2<f64>| Vector::new(point.x as f32, point.y as f32);
        for (a, b) in &self.walls {
            let wall = ColliderBuilder::segment(single(a), single(b)).friction(CONTACT_FRICTION);
            physics.insert_collider(wall, None);
        }
        let mut insert = |disc: &Disc, radius: f64, mass: f64| {
            let [x, y, angle] = disc.place;
            let [vx, vy, turning] = disc.velocity;
            let body = RigidBodyBuilder::dynamic()
                .translation(Vector::new(x, y))
                .rotation(angle)
                .linvel(Vector::new(vx, vy))
                .angvel(turning)
                .can_sleep(false)
                .ccd_enabled(true);
            let ball =
                ColliderBuilder::ball(radius as f32).mass(mass as f32).friction(CONTACT_FRICTION).restitution(0.0);
            physics.insert(body, ball).0
        };
        let robot = insert(&self.robot, self.radius, self.settings.mass);
        let things = self.things.iter().zip(&self.movables).map(|(disc, thing)| insert(disc, thing.radius, thing.mass));
        let things = things.collect();
        Contacts { physics, robot, things }
    }

    /// One step of motors, wheels and odometry.
    fn drive(&mut self, physics: &mut PhysicsWorld, robot: RigidBodyHandle) {
        let settings = &self.settings;
        let wanted = if self.commanded < COMMAND_HOLDS { self.command } else { Velocity::ZERO };
        self.commanded += STEP;
        let towards = |now: f64, wanted: f64, change: f64| wanted.clamp(now - change * STEP, now + change * STEP);
        self.target = Velocity {
            linear: towards(self.target.linear, wanted.linear, settings.acceleration),
            angular: towards(self.target.angular, wanted.angular, settings.turn_acceleration),
        };
        let Disc { place, velocity } = self.robot;
        let [vx, vy, turning] = velocity.map(f64::from);
        let heading = Pose::new(Point2::origin(), f64::from(place[2])).direction();
        let aside = Vector2::new(-heading.y, heading.x);
        let floor = Vector2::new(vx, vy);
        let (ahead, sideways) = (floor.dot(&heading), floor.dot(&aside));
        let half = TRACK * self.radius;
        // What the floor takes from one wheel, which carries half of the robot.
        let held = 0.5 * settings.traction * settings.mass * GRAVITY;
        let most = held.min(0.5 * settings.motor_force);
        let (mut forces, mut rims) = ([0.0; 2], [0.0; 2]);
        for (wheel, side) in [-1.0, 1.0].into_iter().enumerate() {
            let wanted = self.target.linear + side * half * self.target.angular;
            let ground = ahead + side * half * turning;
            let needed = 0.5 * settings.mass * (wanted - ground) / MOTOR_SECONDS;
            forces[wheel] = needed.clamp(-most, most);
            rims[wheel] = match needed.abs() >= held && held <= 0.5 * settings.motor_force {
                // It spins.
                true => wanted,
                false => ground + settings.creep * forces[wheel] / held,
            };
        }
        let across = (-settings.mass * sideways / MOTOR_SECONDS).clamp(-2.0 * held, 2.0 * held);
        let force = heading * (forces[0] + forces[1]) + aside * across;
        let torque = half * (forces[1] - forces[0]);
        let body = &mut physics.bodies[robot];
        body.reset_forces(true);
        body.reset_torques(true);
        body.add_force(Vector::new(force.x as f32, force.y as f32), true);
        body.add_torque(torque as f32, true);
        let counted = [0, 1].map(|wheel| {
            let noise: f64 = self.random.sample(StandardNormal);
            rims[wheel] * self.wheels[wheel] * (1.0 + self.noise * noise)
        });
        let velocity =
            Velocity { linear: 0.5 * (counted[0] + counted[1]), angular: (counted[1] - counted[0]) / (2.0 * half) };
        let pose = self.odometry.pose;
        let between = Pose::new(pose.position, pose.heading + 0.5 * velocity.angular * STEP);
        let position = pose.position + between.direction() * (velocity.linear * STEP);
        // What is published as velocity is that of the wheels, without the noise of single steps.
        let velocity = Velocity { linear: 0.5 * (rims[0] + rims[1]), angular: (rims[1] - rims[0]) / (2.0 * half) };
        self.odometry = Odometry {
            pose: Pose::new(position, pose.heading + (counted[1] - counted[0]) / (2.0 * half) * STEP),
            velocity,
        };
    }

    /// The floor brakes what was pushed.
    fn slow_down(&self, physics: &mut PhysicsWorld, things: &[RigidBodyHandle]) {
        for (&handle, thing) in things.iter().zip(&self.movables) {
            let body = &mut physics.bodies[handle];
            let velocity = body.linvel();
            let speed = f64::from(velocity.length());
            let less = (thing.friction * GRAVITY * STEP).min(speed);
            let rest = if speed > 0.0 { ((speed - less) / speed) as f32 } else { 0.0 };
            let turning = body.angvel() * rest;
            body.set_linvel(velocity * rest, true);
            body.set_angvel(turning, true);
        }
    }

    fn is_pressed(&self, physics: &PhysicsWorld, robot: RigidBodyHandle) -> bool {
        let heading = self.pose().direction();
        let [x, y, _] = self.robot.place;
        physics.bodies[robot].colliders().iter().any(|&collider| {
            physics.contact_pairs_with(collider).any(|pair| {
                let other = if pair.collider1 == collider { pair.collider2 } else { pair.collider1 };
                pair.has_any_active_contact() && {
                    let other = &physics.colliders[other];
                    let near = other.shape().project_point(other.position(), Vector::new(x, y), true).point;
                    let to = Vector2::new(f64::from(near.x - x), f64::from(near.y - y));
                    to.dot(&heading) > 0.5 * to.norm()
                }
            })
        })
    }
}

fn disc_of(physics: &PhysicsWorld, handle: RigidBodyHandle) -> Disc {
    let body = &physics.bodies[handle];
    let (place, velocity) = (body.translation(), body.linvel());
    Disc { place: [place.x, place.y, body.rotation().angle()], velocity: [velocity.x, velocity.y, body.angvel()] }
}

impl Persist for Dynamic {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let flat = |disc: &Disc| [disc.place, disc.velocity].concat();
        let mut discs: Vec<f32> = std::iter::once(&self.robot).chain(&self.things).flat_map(flat).collect();
        snapshot.numbers("discs", &mut discs)?;
        snapshot.check("discs", discs.len() == 6 * (1 + self.things.len()), "another number of things")?;
        let of = |six: &[f32]| Disc { place: [six[0], six[1], six[2]], velocity: [six[3], six[4], six[5]] };
        for (disc, six) in std::iter::once(&mut self.robot).chain(&mut self.things).zip(discs.chunks_exact(6)) {
            *disc = of(six);
        }
        let Odometry { pose, velocity } = self.odometry;
        let velocities = [velocity, self.command, self.target].map(|of| [of.linear, of.angular]);
        let mut numbers = vec![pose.position.x, pose.position.y, pose.heading, self.commanded];
        numbers.extend(velocities.as_flattened());
        snapshot.numbers("numbers", &mut numbers)?;
        let [x, y, heading, commanded, a, b, c, d, e, f] = numbers[..] else {
            return snapshot.check("numbers", false, "not ten numbers");
        };
        let velocity = |linear, angular| Velocity { linear, angular };
        // Not by `Pose::new`: the heading is in its range already, and every bit counts.
        let pose = Pose { position: Point2::new(x, y), heading };
        self.odometry = Odometry { pose, velocity: velocity(a, b) };
        (self.commanded, self.command, self.target) = (commanded, velocity(c, d), velocity(e, f));
        snapshot.value("touched", &mut self.touched)?;
        snapshot.random("random", &mut self.random)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;
    use crate::robot::wrap;

    /// The lab with a body, and what else is set.
    fn scenario(more: &str, set: &[&str]) -> Scenario {
        let text = include_str!("../../scenarios/lab.toml").to_owned() + more;
        let sets = set.iter().chain(&["robot.body=dynamic"]).map(|&set| set.to_owned()).collect::<Vec<_>>();
        Scenario::parse(&text, "lab.toml".as_ref(), &sets).unwrap()
    }

    fn body(scenario: &Scenario, x: f64, y: f64, heading: f64) -> Dynamic {
        let start = Pose::new(Point2::new(x, y), heading);
        let things: Vec<[f64; 2]> = scenario.world.movables.iter().map(|thing| thing.at).collect();
        Dynamic::new(scenario, scenario.body.as_ref().unwrap(), start, &things, stream(1, "motion"))
    }

    /// Drive like this for some seconds; the highest speed and the highest acceleration ahead.
    fn drive(body: &mut Dynamic, linear: f64, angular: f64, seconds: f64) -> (f64, f64) {
        let (mut fastest, mut quickest, mut before) = (0.0_f64, 0.0_f64, None);
        let mut contacts = body.contacts();
        for step in 0..(seconds / STEP).round() as usize {
            if step % 10 == 0 {
                body.command(Velocity { linear, angular });
            }
            body.step(&mut contacts);
            let [vx, vy, _] = body.robot.velocity.map(f64::from);
            let ahead = Vector2::new(vx, vy).dot(&body.pose().direction());
            fastest = fastest.max(ahead);
            quickest = quickest.max(before.map_or(0.0, |before: f64| (ahead - before).abs() / STEP));
            before = Some(ahead);
        }
        (fastest, quickest)
    }

    #[test]
    fn it_drives_as_fast_as_it_is_told_and_no_quicker_than_its_motors_let_it() {
        let scenario = scenario("", &["robot.odometry_noise=0", "body.wheel_error=0"]);
        let mut robot = body(&scenario, 0.5, 0.9, 0.0);
        let (fastest, quickest) = drive(&mut robot, 0.4, 0.0, 3.0);
        assert!((fastest - 0.4).abs() < 0.01, "{fastest} m/s");
        assert!(quickest <= 1.05 * scenario.body.as_ref().unwrap().acceleration, "{quickest} m/s²");
        let driven = (robot.pose().position.x - 0.5, robot.odometry().pose.position.x - 0.5);
        assert!((driven.0 - driven.1).abs() < 0.01 && driven.0 > 1.0, "{driven:?}");
        // Without a command it stops by itself.
        let mut contacts = robot.contacts();
        (0..300).for_each(|_| robot.step(&mut contacts));
        assert!(robot.odometry().velocity.linear.abs() < 1e-3);
        let mut robot = body(&scenario, 1.5, 0.9, 0.0);
        drive(&mut robot, 0.0, 1.0, 2.0);
        let (turned, counted) = (robot.pose().heading, robot.odometry().pose.heading);
        assert!(wrap(turned - counted).abs() < 0.03 && (turned - 1.9).abs() < 0.1, "{turned} {counted}");
    }

    #[test]
    fn odometry_is_wrong_by_what_wheels_slip_and_stands_still_where_motors_stall() {
        let error = |traction: &str| {
            let scenario = scenario("", &["robot.odometry_noise=0", "body.wheel_error=0", traction]);
            let mut robot = body(&scenario, 0.5, 0.9, 0.0);
            (0..4).for_each(|_| {
                drive(&mut robot, 0.4, 0.0, 0.7);
                drive(&mut robot, -0.4, 0.0, 0.4);
            });
            (robot.pose().position - robot.odometry().pose.position).norm()
        };
        let (good, ice) = (error("body.traction=0.6"), error("body.traction=0.1"));
        assert!(good < 0.02 && ice > 3.0 * good, "{good} m, on ice {ice} m");
        // Against a wall: it is not in it, and odometry advances by less than a tenth of what is told.
        let scenario = scenario("", &[]);
        let mut robot = body(&scenario, 2.6, 0.9, 0.0);
        drive(&mut robot, 0.4, 0.0, 1.0);
        let (at, counted) = (robot.pose(), robot.odometry().pose.position.x);
        assert!((at.position.x - 2.75).abs() < 0.01 && robot.is_touched(), "{at:?}");
        drive(&mut robot, 0.4, 0.0, 2.0);
        let advanced = robot.odometry().pose.position.x - counted;
        assert!(advanced.abs() < 0.08, "odometry goes {advanced} m of 0.8 m");
    }

    #[test]
    fn it_never_gets_into_a_wall_or_through_it() {
        let scenario = scenario("", &[]);
        let mut robot = body(&scenario, 1.5, 0.9, 0.0);
        let mut rng = stream(2, "wild");
        let begun = std::time::Instant::now();
        for _ in 0..2000 {
            let (linear, angular) = (rng.random_range(-1.0..1.5), rng.random_range(-3.0..3.0));
            drive(&mut robot, linear, angular, 0.25);
            let Point2 { coords } = robot.pose().position;
            let inside = (0.24..2.76).contains(&coords.x) && (0.24..1.56).contains(&coords.y);
            assert!(inside, "{coords}");
        }
        println!("{:.1} µs a step", begun.elapsed().as_secs_f64() * 1e6 / 100_000.0);
    }

    #[test]
    fn what_is_pushed_moves_and_slows_the_robot_down() {
        let bin = "[[world.movable]]\nat = [1.6, 0.9]\nradius = 0.15\nmass = 4.0\n";
        let scenario = scenario(bin, &["body.motor_force=20"]);
        let mut robot = body(&scenario, 0.9, 0.9, 0.0);
        drive(&mut robot, 0.4, 0.0, 2.5);
        let thing = robot.things().next().unwrap().0;
        assert!(thing.x > 1.7 && (thing.x - robot.pose().position.x) > 0.39, "{thing} {:?}", robot.pose());
        let free = {
            let scenario = super::tests::scenario("", &["body.motor_force=20"]);
            let mut robot = body(&scenario, 0.9, 0.9, 0.0);
            drive(&mut robot, 0.4, 0.0, 2.5);
            robot.pose().position.x
        };
        assert!(robot.pose().position.x < free - 0.02);
        // It stays where it was left.
        drive(&mut robot, -0.3, 0.0, 1.0);
        let left = robot.things().next().unwrap().0;
        drive(&mut robot, 0.0, 0.5, 1.0);
        assert_eq!(robot.things().next().unwrap().0, left);
    }

    #[test]
    fn it_goes_on_bit_for_bit_where_it_was_saved() {
        let bin = "[[world.movable]]\nat = [1.6, 0.9]\n";
        let scenario = scenario(bin, &[]);
        let mut robot = body(&scenario, 0.9, 0.8, 0.1);
        drive(&mut robot, 0.4, 0.2, 2.0);
        let mut saved = Snapshot::new();
        robot.persist(&mut saved).unwrap();
        let mut again = body(&scenario, 0.3, 0.3, 0.0);
        let mut restoring = Snapshot::restoring(saved.matrices, saved.texts);
        again.persist(&mut restoring).unwrap();
        for robot in [&mut robot, &mut again] {
            drive(robot, 0.5, -0.4, 1.5);
        }
        assert_eq!((again.robot, again.odometry), (robot.robot, robot.odometry));
        assert_eq!(again.things, robot.things);
    }
}
