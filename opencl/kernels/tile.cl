// The part of the picture that a tile covers, in pixels.
typedef struct {
    int left, top, columns, rows;
} Tile;

static inline Tile tile_of(int index, int width, int height) {
    const int across = (width + TILE - 1) / TILE;
    Tile tile;
    tile.left = index % across * TILE;
    tile.top = index / across * TILE;
    tile.columns = width - tile.left < TILE ? width - tile.left : TILE;
    tile.rows = height - tile.top < TILE ? height - tile.top : TILE;
    return tile;
}
