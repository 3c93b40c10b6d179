// Products of observations with vectors that stay on the device, and kernel values of them.
//
// One group of 256 threads computes a square of TILE × TILE products. Parts of DEPTH values of its vectors and observations are
// kept in memory that the group shares, value by value, so that a thread loads four vectors' at once: a load from there costs a
// multiplication. Each thread sums the products of some four vectors, in every 64, with some four observations in every 64.
// What depends on their number is written out by rows.rs: sums with names in place of indices stay in registers, and where a part's
// values have numbers, nothing is counted, and of two indices only the second, which is the same for all of them, has to be checked.

struct Sizes {
    /// From one observation's products to the next one's, in fours.
    stride: u32,
    /// Fours of values in a vector.
    quads: u32,
    /// 0: products. 1: radial kernel.
    kernel: u32,
    /// 2σ², half of the exponent.
    scale: f32,
    half: f32,
    unused_x: u32,
    unused_y: u32,
    unused_z: u32,
}

@group(0) @binding(0) var<uniform> sizes: Sizes;
@group(0) @binding(1) var<storage, read> vectors: array<vec4f>;
@group(0) @binding(2) var<storage, read> observations: array<vec4f>;
/// Squared norms: of the vectors, in fours.
@group(0) @binding(3) var<storage, read> vector_norms: array<vec4f>;
@group(0) @binding(4) var<storage, read> observation_norms: array<f32>;
@group(0) @binding(5) var<storage, read_write> results: array<vec4f>;

// A line, of one value of all, is LINE fours long, one more than a tile: fewer of the threads that write at once meet in a bank.
var<workgroup> of_vectors: array<array<vec4f, LINE>, DEPTH>;
var<workgroup> of_observations: array<array<vec4f, LINE>, DEPTH>;

fn values(products: vec4f, four: u32, j: u32) -> vec4f {
    if sizes.kernel == 0u {
        return products;
    }
    let squared = max(vector_norms[four] + observation_norms[j] - 2.0 * products, vec4f(0.0));
    if sizes.half == 1.0 {
        return exp(-squared / sizes.scale);
    }
    return exp(-pow(squared / sizes.scale, vec4f(sizes.half)));
}

// There is room for whole tiles: what stands behind the last vector and observation is not read by anybody.
fn store(products: vec4f, four: u32, j: u32) {
    results[j * sizes.stride + four] = values(products, four, j);
}

@compute @workgroup_size(256)
fn products(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let first_vector = group.x * TILE;
    let first_observation = group.y * TILE;
    // 16 × 16 threads, such that 32 of them, which many devices run in step, are 8 × 4 and load no more than they need.
    let lane = thread % 32u;
    let block = thread / 32u;
    let x = (block % 2u) * 8u + lane % 8u;
    let y = (block / 2u) * 4u + lane / 8u;
    // What this thread brings: four values of four vectors, or of four observations. They are turned, so that whole fours are
    // written; devices may write all four where only one is meant.
    let four = (thread % TILE) / 4u;
    let quad = thread % 4u;
    let to = quad * 4u;
//SUMS//
    for (var begin = 0u; begin < sizes.quads; begin += DEPTH / 4u) {
        if thread < TILE {
            let at = (first_vector + 4u * four) * sizes.quads + begin + quad;
            let second = at + sizes.quads;
            let third = second + sizes.quads;
            let turned = transpose(mat4x4f(vectors[at], vectors[second], vectors[third], vectors[third + sizes.quads]));
            of_vectors[to][four] = turned[0];
            of_vectors[to + 1u][four] = turned[1];
            of_vectors[to + 2u][four] = turned[2];
            of_vectors[to + 3u][four] = turned[3];
        } else if thread < 2u * TILE {
            let at = (first_observation + 4u * four) * sizes.quads + begin + quad;
            let second = at + sizes.quads;
            let third = second + sizes.quads;
            let turned = transpose(
                mat4x4f(observations[at], observations[second], observations[third], observations[third + sizes.quads])
            );
            of_observations[to][four] = turned[0];
            of_observations[to + 1u][four] = turned[1];
            of_observations[to + 2u][four] = turned[2];
            of_observations[to + 3u][four] = turned[3];
        }
        workgroupBarrier();
//PRODUCTS//
        workgroupBarrier();
    }
//STORES//
}
