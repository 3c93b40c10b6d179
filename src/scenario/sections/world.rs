//! `[world]`: walls, surfaces, and what moves by itself.

use std::path::Path;

use super::body::Movable;
use crate::scenario::distractors::Distractor;
use crate::scenario::keys::{Reader, above};
use crate::scenario::pyramids::Pyramid;
use crate::scenario::rooms::{Room, Wall, walls_of};
use crate::scenario::texture::{Defaults, Texture};

/// Who renders what the camera sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renderer {
    /// Many views at once: whichever is faster on this machine. Single ones: the processor.
    Auto,
    /// The processor.
    Cpu,
    /// A graphics processor, if there is one.
    Gpu,
}

/// `[world]`: what the robot drives in.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// Who renders what the camera sees.
    pub renderer: Renderer,
    /// `[[world.room]]`
    pub rooms: Vec<Room>,
    /// `[[world.wall]]`, and behind them four walls for each room, in the order of [`SIDES`](crate::scenario::SIDES).
    pub walls: Vec<Wall>,
    /// `[[world.pyramid]]`
    pub pyramids: Vec<Pyramid>,
    /// `[[world.distractor]]`
    pub distractors: Vec<Distractor>,
    /// `[[world.movable]]`
    pub movables: Vec<Movable>,
    /// `[world.floor]`
    pub floor: Texture,
    /// `[world.surroundings]`: what is seen above the walls, far away.
    pub surroundings: Texture,
}

impl World {
    pub(super) fn read(reader: &mut Reader<'_>, base: &Path) -> Self {
        let (texture_seed, renderer) = reader.section("world", "what the robot drives in", |s| {
            s.allow_sections(&["room", "wall", "pyramid", "distractor", "movable", "floor", "surroundings"]);
            let line = "seed of the textures of walls and floor; another number: other patterns of the same kinds";
            let texture_seed = s.count("texture_seed", 0, "", 0..=1_000_000, line) as u64;
            let words = [("auto", Renderer::Auto), ("cpu", Renderer::Cpu), ("gpu", Renderer::Gpu)];
            let line = "who renders: auto takes a graphics processor for many views at once, where that is faster";
            (texture_seed, s.choice("renderer", &words, line))
        });
        let rooms = reader.sections("world.room", "a rectangle of floor; rooms that touch or overlap are joined", {
            |s, index| Room::read(s, base, index)
        });
        let mut walls = reader.sections("world.wall", "a polyline that stands upright", |s, index| Wall {
            points: s.points("points", "corners"),
            closed: s.flag("closed", false, "whether the last corner is joined to the first"),
            gaps: Vec::new(),
            height: s.number("height", 0.9, "m", above(0.0, 100.0), "height of the wall"),
            texture: Texture::read(s, base, Defaults::wall(index)),
        });
        walls.extend(walls_of(&rooms));
        walls.iter_mut().for_each(|wall| wall.texture.reseed(texture_seed));
        let pyramids = reader.sections("world.pyramid", "stands outside, far away", Pyramid::read);
        let distractors = reader.sections(
            "world.distractor",
            "moves or blinks whatever the robot does; seen and not felt",
            Distractor::read,
        );
        let movables = reader.sections("world.movable", "can be pushed by a robot with a mass", Movable::read);
        let mut floor = reader.section("world.floor", "", |s| Texture::read(s, base, Defaults::FLOOR));
        floor.reseed(texture_seed);
        let surroundings = reader.section("world.surroundings", "seen above the walls, far away", |s| {
            Texture::read(s, base, Defaults::SURROUNDINGS)
        });
        World { renderer, rooms, walls, pyramids, distractors, movables, floor, surroundings }
    }
}
