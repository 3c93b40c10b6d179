// Many views of one world. Each thread finds the colours of four pixels in a row of memory, which are three words of results.
//
// What a pixel shows is decided by the same geometry as in camera.rs, along the ray through its middle.

struct Common {
    /// Pixels of a view.
    width: u32,
    height: u32,
    /// Fours of pixels in a view.
    fours: u32,
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
    /// Slope of the top row, and by how much each row below looks lower.
    slope: f32,
    fall: f32,
    mount: f32,
    /// Sky: periods in each degree, around and upwards.
    around: f32,
    upwards: f32,
    floor_periods_x: f32,
    floor_periods_y: f32,
    unused_x: u32,
    unused_y: u32,
}

@group(0) @binding(0) var<uniform> every: Common;
/// Columns, panels, pyramids, textures: numbers as their bits.
@group(0) @binding(1) var<storage, read> scene: array<vec4u>;
@group(0) @binding(2) var<storage, read> texels: array<u32>;
@group(0) @binding(3) var<storage, read> views: array<vec4u>;
@group(0) @binding(4) var<storage, read_write> results: array<u32>;

/// Rays that miss the end of a panel by less than this hit it, metres: what f32 leaves of such distances.
const SLACK: f32 = 1e-5;
/// Farther than everything.
const FAR: f32 = 3.0e38;
const NONE: u32 = 0xffffffffu;

struct Eye {
    place: vec2f,
    ahead: vec2f,
    floor_phase: vec2f,
    around_phase: f32,
    /// Where its distractors begin.
    distractors_at: u32,
}

fn eye_of(view: u32) -> Eye {
    let at = view * every.stride;
    let first = bitcast<vec4f>(views[at]);
    let second = bitcast<vec4f>(views[at + 1u]);
    return Eye(first.xy, first.zw, second.xy, second.z, at + 2u);
}

/// A ray: its direction on the floor plan and its rise, both for each metre of depth.
struct Ray {
    plan: vec2f,
    slope: f32,
}

fn perp(a: vec2f, b: vec2f) -> f32 {
    return a.x * b.y - a.y * b.x;
}

/// The texel of a surface at coordinates in periods; `texture`: where its texels begin, and how many there are along and upwards.
fn texel(texture: vec4u, along: f32, up: f32) -> u32 {
    let column = min(u32(fract(along) * f32(texture.y)), texture.y - 1u);
    let row = min(u32(fract(up) * f32(texture.z)), texture.z - 1u);
    return texels[texture.x + column * texture.z + row];
}

/// The colour of a pixel, counted row by row; the last four may go beyond the view's end.
fn colour(eye: Eye, pixel: u32) -> u32 {
    let inside = min(pixel, every.width * every.height - 1u);
    let at = vec2u(inside % every.width, inside / every.width);
    // Aside, bearing in degrees, degrees of elevation for each unit of slope.
    let column = bitcast<vec4f>(scene[at.x]);
    let ray = Ray(eye.ahead + column.x * vec2f(eye.ahead.y, -eye.ahead.x), every.slope - f32(at.y) * every.fall);
    let wall = nearest_panel(eye, ray, at.y);
    let present = nearest_distractor(eye, ray, wall.depth);
    if present != NONE {
        return views[present].y;
    }
    if wall.panel != NONE {
        return wall_texel(wall, ray);
    }
    // Pyramids stand behind all walls.
    if every.pyramids > 0u {
        let pyramid = nearest_pyramid(eye, ray);
        if pyramid.face < 4u {
            return scene[pyramid.at + 3u][pyramid.face];
        }
    }
    if at.y >= every.horizon {
        let depth = every.mount / -ray.slope;
        let place = eye.floor_phase + ray.plan * depth * vec2f(every.floor_periods_x, every.floor_periods_y);
        return texel(scene[every.textures_at], place.x, place.y);
    }
    let around = eye.around_phase - column.y * every.around;
    return texel(scene[every.textures_at + 2u], around, ray.slope * every.upwards * column.z);
}

struct OnPanel {
    depth: f32,
    /// Where in `scene` the panel is.
    panel: u32,
    /// From its beginning, metres.
    along: f32,
}

/// Of two at the same depth the first one, as in the other renderer.
fn nearest_panel(eye: Eye, ray: Ray, row: u32) -> OnPanel {
    var found = OnPanel(FAR, NONE, 0.0);
    for (var i = 0u; i < every.panels; i++) {
        let at = every.panels_at + 2u * i;
        // Beginning and direction; length, offset, height.
        let ends = bitcast<vec4f>(scene[at]);
        let sizes = bitcast<vec4f>(scene[at + 1u]);
        let to = ends.xy - eye.place;
        let gap = perp(to, ends.zw);
        let side = sign(gap);
        // The depth is `gap / across`, and the place on the panel `place / across`.
        let across = side * perp(ray.plan, ends.zw);
        let place = side * perp(to, ray.plan);
        if across > 1e-9 && place >= -SLACK * across && place <= (sizes.x + SLACK) * across {
            let depth = abs(gap) / across;
            let height = every.mount + ray.slope * depth;
            if depth < found.depth && height <= sizes.z && (height > 0.0 || row < every.horizon) {
                found = OnPanel(depth, at, place / across);
            }
        }
    }
    return found;
}

fn wall_texel(wall: OnPanel, ray: Ray) -> u32 {
    let sizes = scene[wall.panel + 1u];
    let texture = every.textures_at + sizes.w;
    let periods = bitcast<vec2f>(scene[texture + 1u].xy);
    let place = vec2f(bitcast<f32>(sizes.y) + wall.along, every.mount + ray.slope * wall.depth) * periods;
    return texel(scene[texture], place.x, place.y);
}

/// Where in `views` the nearest one before a depth is; that of its colour, the second of its rows.
fn nearest_distractor(eye: Eye, ray: Ray, before: f32) -> u32 {
    var nearest = before;
    var found = NONE;
    for (var i = 0u; i < every.distractors; i++) {
        let at = eye.distractors_at + 2u * i;
        // Centre, radius, bottom; top.
        let round = bitcast<vec4f>(views[at]);
        let top = bitcast<f32>(views[at + 1u].x);
        let to = round.xy - eye.place;
        let squared = dot(ray.plan, ray.plan);
        let ahead = dot(to, ray.plan);
        let under_root = ahead * ahead - squared * (dot(to, to) - round.z * round.z);
        let depth = (ahead - sqrt(max(under_root, 0.0))) / squared;
        let height = every.mount + ray.slope * depth;
        if under_root >= 0.0 && depth > 0.0 && depth < nearest && height <= top && height > round.w {
            nearest = depth;
            found = at + 1u;
        }
    }
    return found;
}

struct OnPyramid {
    depth: f32,
    /// Where in `scene` the pyramid is.
    at: u32,
    /// 4: none.
    face: u32,
}

fn nearest_pyramid(eye: Eye, ray: Ray) -> OnPyramid {
    var found = OnPyramid(FAR, 0u, 4u);
    for (var i = 0u; i < every.pyramids; i++) {
        let at = every.pyramids_at + 4u * i;
        // Centre, half of the base, height; the normals of its faces on the floor plan.
        let base = bitcast<vec4f>(scene[at]);
        let two = bitcast<vec4f>(scene[at + 1u]);
        let four = bitcast<vec4f>(scene[at + 2u]);
        let slant = base.w / base.z;
        let to = base.xy - eye.place;
        // Inside of a face: rate · depth ≤ room.
        let rates = ray.slope + slant * vec4f(
            dot(ray.plan, two.xy), dot(ray.plan, two.zw), dot(ray.plan, four.xy), dot(ray.plan, four.zw)
        );
        let rooms = base.w - every.mount + slant * vec4f(dot(to, two.xy), dot(to, two.zw), dot(to, four.xy), dot(to, four.zw));
        var enter = 0.0;
        var leave = FAR;
        var face = 4u;
        for (var f = 0u; f < 4u; f++) {
            let rate = rates[f];
            let room = rooms[f];
            if rate < 0.0 {
                if room / rate > enter {
                    enter = room / rate;
                    face = f;
                }
            } else if rate > 0.0 {
                leave = min(leave, room / rate);
            } else if room < 0.0 {
                leave = -1.0;
            }
        }
        if face < 4u && enter <= leave && enter < found.depth && every.mount + ray.slope * enter >= 0.0 {
            found = OnPyramid(enter, at, face);
        }
    }
    return found;
}

@compute @workgroup_size(128)
fn draw(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= every.fours {
        return;
    }
    let eye = eye_of(id.y);
    let pixel = 4u * id.x;
    let colours = vec4u(colour(eye, pixel), colour(eye, pixel + 1u), colour(eye, pixel + 2u), colour(eye, pixel + 3u));
    let four = colours & vec4u(0xffffffu);
    // Red, green and blue, a byte each, one pixel behind the other.
    let at = 3u * (id.y * every.fours + id.x);
    results[at] = four.x | (four.y << 24u);
    results[at + 1u] = (four.y >> 8u) | (four.z << 16u);
    results[at + 2u] = (four.z >> 16u) | (four.w << 8u);
}
