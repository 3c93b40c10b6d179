// Products of observations with vectors that stay on the device, and kernel values of them.
//
// One group of 16 × 16 threads computes a square of TILE × TILE products. Parts of DEPTH values of its vectors and observations are
// kept in memory that the group shares; each thread sums PER × PER products, those of every 16th vector with every 16th observation.
// What depends on PER is written out by rows.rs: loads, sums and stores with names in place of indices stay in registers.

struct Sizes {
    /// Vectors, and from one observation's products to the next one's.
    vectors: u32,
    stride: u32,
    observations: u32,
    /// Rows of four values in a vector.
    quads: u32,
    /// 0: products. 1: radial kernel.
    kernel: u32,
    /// 2σ², half of the exponent.
    scale: f32,
    half: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> sizes: Sizes;
@group(0) @binding(1) var<storage, read> vectors: array<vec4f>;
@group(0) @binding(2) var<storage, read> observations: array<vec4f>;
/// Squared norms: of the vectors.
@group(0) @binding(3) var<storage, read> vector_norms: array<f32>;
@group(0) @binding(4) var<storage, read> observation_norms: array<f32>;
@group(0) @binding(5) var<storage, read_write> results: array<f32>;

// A row of the group's memory is PITCH long, a little more than a tile: threads that write at once then write to different banks.
var<workgroup> of_vectors: array<f32, DEPTH * PITCH>;
var<workgroup> of_observations: array<f32, DEPTH * PITCH>;

fn value(product: f32, i: u32, j: u32) -> f32 {
    if sizes.kernel == 0u {
        return product;
    }
    let squared = max(vector_norms[i] + observation_norms[j] - 2.0 * product, 0.0);
    if sizes.half == 1.0 {
        return exp(-squared / sizes.scale);
    }
    return exp(-pow(squared / sizes.scale, sizes.half));
}

fn store(product: f32, i: u32, j: u32) {
    if i < sizes.vectors && j < sizes.observations {
        results[j * sizes.stride + i] = value(product, i, j);
    }
}

@compute @workgroup_size(16, 16)
fn products(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let first_vector = group.x * TILE;
    let first_observation = group.y * TILE;
    let thread = local.y * 16u + local.x;
    // What this thread brings: four values of every 64th vector and observation.
    let brought = thread / 4u;
    let quad = thread % 4u;
//SUMS//
    for (var begin = 0u; begin < sizes.quads; begin += DEPTH / 4u) {
        for (var row = brought; row < TILE; row += 64u) {
            let s = vectors[(first_vector + row) * sizes.quads + begin + quad];
            let x = observations[(first_observation + row) * sizes.quads + begin + quad];
            let at = quad * 4u * PITCH + row;
            of_vectors[at] = s.x;
            of_vectors[at + PITCH] = s.y;
            of_vectors[at + 2u * PITCH] = s.z;
            of_vectors[at + 3u * PITCH] = s.w;
            of_observations[at] = x.x;
            of_observations[at + PITCH] = x.y;
            of_observations[at + 2u * PITCH] = x.z;
            of_observations[at + 3u * PITCH] = x.w;
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k++) {
            let s_at = k * PITCH + local.x;
            let x_at = k * PITCH + local.y;
//PRODUCTS//
        }
        workgroupBarrier();
    }
//STORES//
}
