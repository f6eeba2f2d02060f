// Counts the Gaussians that draw in each tile, one work-item per tile. Plain and slow; not one of the measured kernels.
__kernel void count_pairs(
    const int width,
    const int height,
    const float alpha_minimum,
    const float alpha_maximum,
    const float transmittance_minimum,
    __global const float *means2d,
    __global const float *conics,
    __global const float *opacities,
    __global const int *starts,
    __global const int *gaussians,
    __global int *drawing,          // per tile: Gaussians that would draw at least one pixel if nothing occluded them
    __global int *contributing      // per tile: (pixel, Gaussian) pairs that are actually blended
) {
    const int tile = get_global_id(0);
    const int columns = (width + TILE - 1) / TILE;
    const int left = tile % columns * TILE, top = tile / columns * TILE;
    const int right = left + TILE < width ? left + TILE : width, bottom = top + TILE < height ? top + TILE : height;
    float transmittance[TILE * TILE];  // negative: finished
    for (int i = 0; i < TILE * TILE; i++) transmittance[i] = 1;
    int drawing_here = 0, contributing_here = 0;
    for (int entry = starts[tile]; entry < starts[tile + 1]; entry++) {
        const int g = gaussians[entry];
        int draws = 0;
        for (int y = top; y < bottom; y++)
            for (int x = left; x < right; x++) {
                const float dx = x + 0.5f - means2d[2 * g], dy = y + 0.5f - means2d[2 * g + 1];
                const float power = -0.5f * (conics[3 * g] * dx * dx + conics[3 * g + 2] * dy * dy)
                    - conics[3 * g + 1] * dx * dy;
                float alpha = opacities[g] * exp(power);
                if (alpha < alpha_minimum) continue;
                draws = 1;
                alpha = alpha < alpha_maximum ? alpha : alpha_maximum;
                const int pixel = (y - top) * TILE + x - left;
                const float after = transmittance[pixel] * (1 - alpha);
                contributing_here += after >= transmittance_minimum;
                transmittance[pixel] = after >= transmittance_minimum ? after : -1;
            }
        drawing_here += draws;
    }
    drawing[tile] = drawing_here;
    contributing[tile] = contributing_here;
}
