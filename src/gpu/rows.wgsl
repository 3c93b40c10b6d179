// Products of observations with vectors that stay on the device, and kernel values of them.
//
// One group computes the products of VECTORS vectors with OBSERVATIONS observations. They lie in memory as a group reads them: the
// first value of each vector of it, then the second of each, and so on. STEP values of all of them are kept at a time in memory that
// the group shares, twice, so that the next ones are written while these are multiplied, and a group waits once a step. What stands
// between TURNS is written out for each of the two. Each thread sums the products of 8 vectors with 8 observations: a load from there
// serves 16 multiplications of four.
// What depends on their number is written out by rows.rs: sums with names in place of indices stay in registers.

struct Sizes {
    /// From one observation's products to the next one's, in fours.
    stride: u32,
    /// Values of a vector.
    values: u32,
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

var<workgroup> of_vectors: array<array<array<vec4f, VECTORS / 4>, STEP>, 2>;
var<workgroup> of_observations: array<array<array<vec4f, OBSERVATIONS / 4>, STEP>, 2>;

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

@compute @workgroup_size(THREADS)
fn products(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let first_observation = group.x * OBSERVATIONS;
    let first_vector = group.y * VECTORS;
    // 16 × 8 threads, such that 32 of them, which many devices run in step, are 8 × 4 and load no more than they need.
    let lane = thread % 32u;
    let block = thread / 32u;
    let x = (block % 2u) * 8u + lane % 8u;
    let y = (block / 2u) * 4u + lane / 8u;
    // What this thread brings: some four vectors' values, twice, and some four observations'.
    let value = thread / (VECTORS / 4u);
    let four = thread % (VECTORS / 4u);
    let value_of_observations = thread / (OBSERVATIONS / 4u);
    let four_of_observations = thread % (OBSERVATIONS / 4u);
    let vectors_from = first_vector / 4u * sizes.values + thread;
    let observations_from = first_observation / 4u * sizes.values + thread;
    var next = vectors[vectors_from];
    var second = vectors[vectors_from + THREADS];
    var next_of_observations = observations[observations_from];
//SUMS//
    for (var begin = 0u; begin < sizes.values; begin += 2u * STEP) {
//TURNS//
        {
            of_vectors[TURN][value][four] = next;
            of_vectors[TURN][value + STEP / 2u][four] = second;
            of_observations[TURN][value_of_observations][four_of_observations] = next_of_observations;
            workgroupBarrier();
            // Behind the last step the same once more.
            let after = min(begin + (TURN + 1u) * STEP, sizes.values - STEP);
            next = vectors[vectors_from + after * (VECTORS / 4u)];
            second = vectors[vectors_from + after * (VECTORS / 4u) + THREADS];
            next_of_observations = observations[observations_from + after * (OBSERVATIONS / 4u)];
//PRODUCTS//
        }
//TURNS//
    }
//STORES//
}
