// Products of observations with vectors that stay on the device, and kernel values of them.
//
// One group of 256 threads computes a square of TILE × TILE products. Parts of DEPTH values of its vectors and observations are
// kept in memory that the group shares, value by value, so that a thread loads four vectors' at once: a load from there costs a
// multiplication. Each thread sums the products of some four vectors, in every 64, with some four observations in every 64.
// What depends on their number is written out by rows.rs: sums with names in place of indices stay in registers, and the longer
// the step of the innermost loop, the less of it is counting.

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

// A line, of one value of all, is LINE fours long, one more than a tile: threads that write at once then write to different banks.
var<workgroup> of_vectors: array<vec4f, DEPTH * LINE>;
var<workgroup> of_observations: array<vec4f, DEPTH * LINE>;

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
    // What this thread brings: four values of every 64th vector and observation.
    let brought = thread / 4u;
    let quad = thread % 4u;
//SUMS//
    for (var begin = 0u; begin < sizes.quads; begin += DEPTH / 4u) {
        for (var row = brought; row < TILE; row += 64u) {
            let of_vector = vectors[(first_vector + row) * sizes.quads + begin + quad];
            let of_observation = observations[(first_observation + row) * sizes.quads + begin + quad];
            let at = quad * 4u * LINE + row / 4u;
            let part = row % 4u;
            of_vectors[at][part] = of_vector.x;
            of_vectors[at + LINE][part] = of_vector.y;
            of_vectors[at + 2u * LINE][part] = of_vector.z;
            of_vectors[at + 3u * LINE][part] = of_vector.w;
            of_observations[at][part] = of_observation.x;
            of_observations[at + LINE][part] = of_observation.y;
            of_observations[at + 2u * LINE][part] = of_observation.z;
            of_observations[at + 3u * LINE][part] = of_observation.w;
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k += STEP) {
//PRODUCTS//
        }
        workgroupBarrier();
    }
//STORES//
}
