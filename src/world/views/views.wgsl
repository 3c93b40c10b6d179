// Many views of one world in one picture, tile by tile.
//
// Every object in view is drawn as two triangles that cover its outline in the tile; what a pixel then shows is decided by the
// same geometry as in camera.rs, along the ray through its middle.

struct Common {
    /// Pixels of a view.
    width: u32,
    height: u32,
    /// Tiles side by side.
    across: u32,
    /// Objects drawn for each view: the background, panels, pyramids, distractors.
    objects: u32,
    panels: u32,
    pyramids: u32,
    distractors: u32,
    /// The first row that looks down.
    horizon: u32,
    /// Where in `scene` things begin; columns are at its beginning.
    panels_at: u32,
    pyramids_at: u32,
    textures_at: u32,
    /// Words of a view in `views`, as rows of four.
    stride: u32,
    /// Pixels of the whole picture.
    whole: vec2f,
    /// Of the pixel that sees `aside`: `middle + aside · per_aside` from the left edge.
    middle: f32,
    per_aside: f32,
    /// Slope of the top row, and by how much each row below looks lower.
    slope: f32,
    fall: f32,
    mount: f32,
    /// Sky: periods in each degree, around and upwards.
    around: f32,
    upwards: f32,
    floor_periods_x: f32,
    floor_periods_y: f32,
}

@group(0) @binding(0) var<uniform> every: Common;
/// Columns, panels, pyramids, textures: numbers as their bits.
@group(0) @binding(1) var<storage, read> scene: array<vec4u>;
@group(0) @binding(2) var<storage, read> texels: array<u32>;
@group(0) @binding(3) var<storage, read> views: array<vec4u>;

/// What is nearer than this is behind the lens, metres.
const NEAR: f32 = 1e-3;
/// Rays that miss the end of a panel by less than this hit it, metres: what f32 leaves of such distances.
const SLACK: f32 = 1e-5;
/// Depth of the background, and of pyramids, which stand behind all walls.
const BACKGROUND: f32 = 1e-12;
const BEHIND: f32 = 1e-7;

struct Eye {
    place: vec2f,
    ahead: vec2f,
    right: vec2f,
    floor_phase: vec2f,
    around_phase: f32,
}

fn eye_of(view: u32) -> Eye {
    let first = bitcast<vec4f>(views[view * every.stride]);
    let second = bitcast<vec4f>(views[view * every.stride + 1u]);
    return Eye(first.xy, first.zw, vec2f(first.w, -first.z), second.xy, second.z);
}

fn perp(a: vec2f, b: vec2f) -> f32 {
    return a.x * b.y - a.y * b.x;
}

/// What the pixels of an object have in common is told with its corners: for each kind of object something else.
struct Corner {
    @builtin(position) position: vec4f,
    /// The tile's first pixel.
    @location(0) @interpolate(flat) tile: vec2u,
    /// Background, panel, pyramid or distractor, and the number of the pyramid.
    @location(1) @interpolate(flat) kind: vec2u,
    @location(2) @interpolate(flat) a: vec4f,
    @location(3) @interpolate(flat) b: vec4f,
    @location(4) @interpolate(flat) c: vec4f,
    @location(5) @interpolate(flat) texture: vec4u,
}

const BACKGROUND_KIND: u32 = 0u;
const PANEL: u32 = 1u;
const PYRAMID: u32 = 2u;
const DISTRACTOR: u32 = 3u;

/// A rectangle of a tile, in pixels.
struct Outline {
    low: vec2f,
    high: vec2f,
}

fn nothing() -> Outline {
    return Outline(vec2f(0.0), vec2f(0.0));
}

fn everything() -> Outline {
    return Outline(vec2f(0.0), vec2f(f32(every.width), f32(every.height)));
}

/// The outline of what lies between two values of `aside`, two depths and two heights.
fn outline(aside: vec2f, depth: vec2f, height: vec2f) -> Outline {
    let columns = every.middle + every.per_aside * vec2f(min(aside.x, aside.y), max(aside.x, aside.y));
    let rise = height - every.mount;
    // A thing above the lens is highest where it is nearest, one below it where it is farthest.
    let steepest = max(rise.y / depth.x, rise.y / depth.y);
    let flattest = min(rise.x / depth.x, rise.x / depth.y);
    let rows = (every.slope - vec2f(steepest, flattest)) / every.fall + 0.5;
    let whole = everything();
    let low = clamp(vec2f(columns.x, rows.x) - 1.0, whole.low, whole.high);
    let high = clamp(vec2f(columns.y, rows.y) + 1.0, whole.low, whole.high);
    return Outline(low, high);
}

fn outline_of_panel(eye: Eye, index: u32) -> Outline {
    let at = every.panels_at + 2u * index;
    let ends = bitcast<vec4f>(scene[at]);
    let more = bitcast<vec4f>(scene[at + 1u]);
    var a = ends.xy - eye.place;
    var b = a + ends.zw * more.x;
    var a_depth = dot(a, eye.ahead);
    var b_depth = dot(b, eye.ahead);
    if a_depth < NEAR && b_depth < NEAR {
        return nothing();
    }
    // The part before the lens.
    if a_depth < NEAR {
        a = mix(a, b, (NEAR - a_depth) / (b_depth - a_depth));
        a_depth = NEAR;
    } else if b_depth < NEAR {
        b = mix(b, a, (NEAR - b_depth) / (a_depth - b_depth));
        b_depth = NEAR;
    }
    let aside = vec2f(dot(a, eye.right) / a_depth, dot(b, eye.right) / b_depth);
    return outline(aside, vec2f(a_depth, b_depth), vec2f(0.0, more.z));
}

/// Of something round on the floor plan.
fn outline_of_round(eye: Eye, centre: vec2f, radius: f32, height: vec2f) -> Outline {
    let to = centre - eye.place;
    let depth = dot(to, eye.ahead);
    let right = dot(to, eye.right);
    if depth + radius < NEAR {
        return nothing();
    }
    if depth - radius < NEAR {
        return everything();
    }
    let depths = vec2f(depth - radius, depth + radius);
    let left = min((right - radius) / depths.x, (right - radius) / depths.y);
    let most = max((right + radius) / depths.x, (right + radius) / depths.y);
    return outline(vec2f(left, most), depths, height);
}

@vertex
fn place_corner(@builtin(vertex_index) number: u32, @builtin(instance_index) instance: u32) -> Corner {
    let view = instance / every.objects;
    let object = instance % every.objects;
    let eye = eye_of(view);
    var corner: Corner;
    corner.tile = vec2u((view % every.across) * every.width, (view / every.across) * every.height);
    var seen = everything();
    if object == 0u {
        corner.kind = vec2u(BACKGROUND_KIND, 0u);
        corner.a = vec4f(eye.ahead, eye.floor_phase);
        corner.b = vec4f(eye.around_phase, 0.0, 0.0, 0.0);
    } else if object - 1u < every.panels {
        let index = object - 1u;
        seen = outline_of_panel(eye, index);
        let at = every.panels_at + 2u * index;
        let ends = bitcast<vec4f>(scene[at]);
        let more = bitcast<vec4f>(scene[at + 1u]);
        let to = ends.xy - eye.place;
        let gap = perp(to, ends.zw);
        let side = sign(gap);
        // For the ray `ahead + aside · right` the depth is `gap / across`, and the place on the panel `place / across`.
        let across = side * vec2f(perp(eye.ahead, ends.zw), perp(eye.right, ends.zw));
        let place = side * vec2f(perp(to, eye.ahead), perp(to, eye.right));
        let texture = every.textures_at + scene[at + 1u].w;
        corner.kind = vec2u(PANEL, 0u);
        corner.a = vec4f(abs(gap), across, more.z);
        corner.b = vec4f(place, more.x, more.y);
        corner.c = vec4f(bitcast<vec2f>(scene[texture + 1u].xy), 0.0, 0.0);
        corner.texture = scene[texture];
    } else if object - 1u - every.panels < every.pyramids {
        let index = object - 1u - every.panels;
        let base = bitcast<vec4f>(scene[every.pyramids_at + 4u * index]);
        // Half of the base's diagonal, and a little more.
        seen = outline_of_round(eye, base.xy, 1.4143 * base.z, vec2f(0.0, base.w));
        corner.kind = vec2u(PYRAMID, index);
        corner.a = vec4f(eye.ahead, base.xy - eye.place);
    } else {
        let index = object - 1u - every.panels - every.pyramids;
        let at = view * every.stride + 2u + 2u * index;
        let round = bitcast<vec4f>(views[at]);
        let top = bitcast<f32>(views[at + 1u].x);
        seen = outline_of_round(eye, round.xy, round.z, vec2f(round.w, top));
        corner.kind = vec2u(DISTRACTOR, 0u);
        corner.a = vec4f(eye.ahead, round.xy - eye.place);
        corner.b = vec4f(round.z, round.w, top, 0.0);
        corner.texture = vec4u(views[at + 1u].y, 0u, 0u, 0u);
    }
    let within = vec2f(
        select(seen.low.x, seen.high.x, (number & 1u) == 1u),
        select(seen.low.y, seen.high.y, number >= 2u),
    );
    let at = (vec2f(corner.tile) + within) / every.whole;
    corner.position = vec4f(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.5, 1.0);
    return corner;
}

/// The texel of a surface at coordinates in periods; `texture`: where its texels begin, and how many there are along and upwards.
fn texel(texture: vec4u, along: f32, up: f32) -> u32 {
    let column = min(u32(fract(along) * f32(texture.y)), texture.y - 1u);
    let row = min(u32(fract(up) * f32(texture.z)), texture.z - 1u);
    return texels[texture.x + column * texture.z + row];
}

struct Pixel {
    @location(0) colour: vec4f,
    @builtin(frag_depth) depth: f32,
}

fn pixel(texel: u32, depth: f32) -> Pixel {
    return Pixel(unpack4x8unorm(texel), depth);
}

/// The nearer, the larger.
fn closeness(depth: f32) -> f32 {
    return 1.0 / (1.0 + depth);
}

@fragment
fn paint(corner: Corner) -> Pixel {
    let at = vec2u(corner.position.xy) - corner.tile;
    let aside = (f32(at.x) + 0.5 - every.middle) / every.per_aside;
    let slope = every.slope - f32(at.y) * every.fall;
    switch corner.kind.x {
        case PANEL: {
            return paint_panel(corner, aside, slope, at.y);
        }
        case PYRAMID: {
            return paint_pyramid(corner, aside, slope);
        }
        case DISTRACTOR: {
            return paint_distractor(corner, aside, slope);
        }
        default: {
            return paint_background(corner, aside, slope, at);
        }
    }
}

/// The ray of a column on the floor plan, for each metre of depth.
fn ray_of(ahead: vec2f, aside: f32) -> vec2f {
    return ahead + aside * vec2f(ahead.y, -ahead.x);
}

fn paint_background(corner: Corner, aside: f32, slope: f32, at: vec2u) -> Pixel {
    if at.y >= every.horizon {
        let depth = every.mount / -slope;
        let periods = vec2f(every.floor_periods_x, every.floor_periods_y);
        let place = corner.a.zw + ray_of(corner.a.xy, aside) * depth * periods;
        return pixel(texel(scene[every.textures_at], place.x, place.y), BACKGROUND);
    }
    // Bearing in degrees, degrees of elevation for each unit of slope.
    let column = bitcast<vec2f>(scene[at.x].xy);
    let around = corner.b.x - column.x * every.around;
    return pixel(texel(scene[every.textures_at + 2u], around, slope * every.upwards * column.y), BACKGROUND);
}

fn paint_panel(corner: Corner, aside: f32, slope: f32, row: u32) -> Pixel {
    let across = corner.a.y + aside * corner.a.z;
    let place = corner.b.x + aside * corner.b.y;
    let depth = corner.a.x / across;
    let height = every.mount + slope * depth;
    let seen = across > 1e-9 && place >= -SLACK * across && place <= (corner.b.z + SLACK) * across
        && height <= corner.a.w && (height > 0.0 || row < every.horizon);
    if !seen {
        discard;
    }
    let along = corner.b.w + place / across;
    return pixel(texel(corner.texture, along * corner.c.x, height * corner.c.y), closeness(depth));
}

fn paint_pyramid(corner: Corner, aside: f32, slope: f32) -> Pixel {
    let at = every.pyramids_at + 4u * corner.kind.y;
    let base = bitcast<vec4f>(scene[at]);
    let two = bitcast<vec4f>(scene[at + 1u]);
    let four = bitcast<vec4f>(scene[at + 2u]);
    let colours = scene[at + 3u];
    let normals = array<vec2f, 4>(two.xy, two.zw, four.xy, four.zw);
    let ray = ray_of(corner.a.xy, aside);
    let slant = base.w / base.z;
    var enter = 0.0;
    var leave = 3.0e38;
    var face = 4u;
    for (var i = 0u; i < 4u; i++) {
        // Inside of a face: rate · depth ≤ room.
        let rate = slope + slant * dot(ray, normals[i]);
        let room = base.w + slant * dot(corner.a.zw, normals[i]) - every.mount;
        if rate < 0.0 {
            if room / rate > enter {
                enter = room / rate;
                face = i;
            }
        } else if rate > 0.0 {
            leave = min(leave, room / rate);
        } else if room < 0.0 {
            leave = -1.0;
        }
    }
    if face == 4u || enter > leave || every.mount + slope * enter < 0.0 {
        discard;
    }
    return pixel(colours[min(face, 3u)], BEHIND * closeness(enter));
}

fn paint_distractor(corner: Corner, aside: f32, slope: f32) -> Pixel {
    let ray = ray_of(corner.a.xy, aside);
    let to = corner.a.zw;
    let radius = corner.b.x;
    let squared = dot(ray, ray);
    let ahead = dot(to, ray);
    let under_root = ahead * ahead - squared * (dot(to, to) - radius * radius);
    let depth = (ahead - sqrt(max(under_root, 0.0))) / squared;
    let height = every.mount + slope * depth;
    if under_root < 0.0 || depth <= 0.0 || height > corner.b.z || height <= corner.b.y {
        discard;
    }
    return pixel(corner.texture.x, closeness(depth));
}
