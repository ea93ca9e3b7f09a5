"""Ways to compute which triangle is visible at each sample, from the plainest to tile lists.

All methods test the same integer edge functions, with vertices on the package's grid, so that all
agree on the visible triangle of every sample. Each method fills `owner [rows, columns]` with the
index of the visible triangle, -1 where there is none. Only the last method stores no samples: it
adds colours to the image at once. Sample (i, j) is column i of row j; later triangles lie in front.

**Source:** edge functions, Pineda, *A Parallel Algorithm for Polygon Rasterization* (SIGGRAPH
1988); masks and tiles, Greene, *Hierarchical Polygon Tiling with Coverage Masks* (SIGGRAPH 1996).
"""

# pyright: reportMissingImports=false

import numba as nb
import numpy as np

RATE = 4
"""Samples along a side of a pixel."""
TILE = 32
"""Samples along a side of a tile, so that a row of them is one word."""

_ONES = np.uint32(0xFFFFFFFF)
_COUNT = np.array([bits.bit_count() for bits in range(1 << RATE)], np.float32)
compiled = nb.njit(cache=True, error_model="numpy")


@compiled
def set_up(corners, bits, size):
    """Edge functions and bounding boxes of `corners [triangles, 3, 2]`, snapped to 2^-bits px.

    `edges [triangles, 3, 3]`: the value at sample (0, 0), its steps right and down; a sample is
    inside where none of the three is below zero. `boxes [triangles, 4]`: first and last column,
    first and last row. All int64.
    """
    edges = np.empty((corners.shape[0], 3, 3), np.int64)
    boxes = np.empty((corners.shape[0], 4), np.int64)
    half = 1 << (bits - 1)
    x, y = np.empty(3, np.int64), np.empty(3, np.int64)
    for t in range(corners.shape[0]):
        for k in range(3):
            x[k] = np.int64(np.rint(np.float64(corners[t, k, 0]) * (1 << bits)))
            y[k] = np.int64(np.rint(np.float64(corners[t, k, 1]) * (1 << bits)))
        if (x[1] - x[0]) * (y[2] - y[0]) < (y[1] - y[0]) * (x[2] - x[0]):
            x[1], x[2], y[1], y[2] = x[2], x[1], y[2], y[1]
        for k in range(3):
            dx, dy = x[(k + 1) % 3] - x[k], y[(k + 1) % 3] - y[k]
            edges[t, k, 0] = (dx * (half - RATE * y[k]) - dy * (half - RATE * x[k])) >> bits
            edges[t, k, 1], edges[t, k, 2] = -dy, dx
        for axis, place in enumerate((x, y)):
            first = (RATE * place.min() + half - 1) >> bits
            last = (RATE * place.max() - half) >> bits
            boxes[t, 2 * axis] = max(first, 0)
            boxes[t, 2 * axis + 1] = min(last, RATE * size - 1)
    return edges, boxes


@compiled
def _along(edges, t, axis, at):
    """The edge functions of a triangle along row (axis 1) or column (axis 2) `at`: start, step."""
    across = 3 - axis
    return (
        (edges[t, 0, 0] + edges[t, 0, across] * at, edges[t, 0, axis]),
        (edges[t, 1, 0] + edges[t, 1, across] * at, edges[t, 1, axis]),
        (edges[t, 2, 0] + edges[t, 2, across] * at, edges[t, 2, axis]),
    )


@compiled
def _inside(line, at):
    (a, da), (b, db), (c, dc) = line
    return a + da * at >= 0 and b + db * at >= 0 and c + dc * at >= 0


@compiled
def box_by_rows(edges, boxes, owner):
    """Test every sample of the bounding box, row after row: the compiler tests several at once."""
    for t in range(boxes.shape[0]):
        left, right, top, bottom = boxes[t]
        for j in range(top, bottom + 1):
            row = _along(edges, t, 1, j)
            for i in range(left, right + 1):
                if _inside(row, i):
                    owner[j, i] = t


@compiled
def box_by_columns(edges, boxes, owner):
    """Test every sample of the bounding box, column after column."""
    for t in range(boxes.shape[0]):
        left, right, top, bottom = boxes[t]
        for i in range(left, right + 1):
            column = _along(edges, t, 2, i)
            for j in range(top, bottom + 1):
                if _inside(column, j):
                    owner[j, i] = t


@compiled
def _one_by_one(edges, boxes, owner, patience):
    """Test rows of the bounding box, each up to `patience` samples past the triangle's far side.

    The compiler does not vectorise a loop that may break.
    """
    for t in range(boxes.shape[0]):
        left, right, top, bottom = boxes[t]
        for j in range(top, bottom + 1):
            row = _along(edges, t, 1, j)
            entered, beyond = False, 0
            for i in range(left, right + 1):
                if _inside(row, i):
                    owner[j, i] = t
                    entered = True
                elif entered:
                    beyond += 1
                    if beyond > patience:
                        break


@compiled
def box_one_by_one(edges, boxes, owner):
    """Test every sample of the bounding box, row after row, one sample at a time."""
    _one_by_one(edges, boxes, owner, 1 << 30)


@compiled
def early_exit(edges, boxes, owner):
    """Like `box_one_by_one`, but each row ends where it leaves the triangle."""
    _one_by_one(edges, boxes, owner, 0)


@compiled
def _first_inside(value, step):
    """The least i with `value + i step >= 0`, for `step > 0`; a float estimate, corrected."""
    guess = np.int64(np.ceil(-np.float64(value) / np.float64(step)))
    if value + guess * step < 0:
        return guess + 1
    return guess - 1 if value + (guess - 1) * step >= 0 else guess


@compiled
def _interval(row, first, last):
    """The samples of `first..last` inside a triangle; they form one interval, as it is convex."""
    for value, step in row:
        if step > 0:
            first = max(first, _first_inside(value, step))
        elif step < 0:
            last = min(last, _first_inside(-1 - value, -step) - 1)
        elif value < 0:
            return 0, -1
    return first, last


@compiled
def spans(edges, boxes, owner):
    """Compute the ends of each row's interval from the edges, and test no samples in between."""
    for t in range(boxes.shape[0]):
        left, right, top, bottom = boxes[t]
        for j in range(top, bottom + 1):
            first, last = _interval(_along(edges, t, 1, j), left, right)
            for i in range(first, last + 1):
                owner[j, i] = t


@compiled
def count_covered(edges, boxes):
    """The number of covered samples, summed over triangles."""
    count = 0
    for t in range(boxes.shape[0]):
        left, right, top, bottom = boxes[t]
        for j in range(top, bottom + 1):
            first, last = _interval(_along(edges, t, 1, j), left, right)
            count += max(last - first + 1, 0)
    return count


@compiled
def _mask(first, last):
    """A word with ones at bits `first..last`, both of which may lie outside the word."""
    first, last = max(first, 0), min(last, TILE - 1)
    if first > last:
        return np.uint32(0)
    return np.uint32((_ONES >> np.uint32(TILE - 1 - last)) & (_ONES << np.uint32(first)))


@compiled
def _write(samples, word, t):
    for i in range(TILE):
        if (word >> np.uint32(i)) & np.uint32(1):
            samples[i] = t


@compiled
def bit_masks(edges, boxes, owner):
    """Draw front to back with a bit per covered sample, so that 32 samples are skipped at once."""
    covered = np.zeros((owner.shape[0], owner.shape[1] // TILE), np.uint32)
    for t in range(boxes.shape[0] - 1, -1, -1):
        left, right, top, bottom = boxes[t]
        for j in range(top, bottom + 1):
            first, last = _interval(_along(edges, t, 1, j), left, right)
            if first > last:
                continue
            for word in range(first // TILE, last // TILE + 1):
                start = word * TILE
                seen = _mask(first - start, last - start) & ~covered[j, word]
                if seen:
                    covered[j, word] |= seen
                    _write(owner[j, start : start + TILE], seen, t)


@compiled
def _touches(edges, t, column, row):
    """Whether, for each edge, some sample of the tile lies on the inner side."""
    for k in range(3):
        value, right, down = edges[t, k]
        most = value + right * column * TILE + down * row * TILE
        if most + (max(right, 0) + max(down, 0)) * (TILE - 1) < 0:
            return False
    return True


@compiled
def list_tiles(edges, boxes, tiles):
    """Triangles of each tile in draw order: `start [tiles * tiles + 1]` and `index`."""
    start = np.zeros(tiles * tiles + 1, np.int64)
    index = np.empty(0, np.int32)
    cursor = start
    for fill in (False, True):
        if fill:
            start = np.cumsum(start)
            index = np.empty(start[-1], np.int32)
            cursor = start[:-1].copy()
        for t in range(boxes.shape[0]):
            left, right, top, bottom = boxes[t]
            if left > right or top > bottom:
                continue
            for row in range(top // TILE, bottom // TILE + 1):
                for column in range(left // TILE, right // TILE + 1):
                    if _touches(edges, t, column, row):
                        tile = row * tiles + column
                        if fill:
                            index[cursor[tile]] = t
                            cursor[tile] += 1
                        else:
                            start[tile + 1] += 1
    return start, index


@compiled
def _see(edges, boxes, t, column, row, covered, seen):
    """Store a triangle's visible samples of a tile in the words `seen`, and mark them covered."""
    left, right, top, bottom = boxes[t]
    start = column * TILE
    for j in range(TILE):
        seen[j] = 0
        if covered[j] != _ONES and top <= row * TILE + j <= bottom:
            line = _along(edges, t, 1, row * TILE + j)
            first, last = _interval(line, max(left, start), min(right, start + TILE - 1))
            seen[j] = _mask(first - start, last - start) & ~covered[j]
            covered[j] |= seen[j]


@compiled
def tile_lists(edges, boxes, owner):
    """Draw by bit masks tile by tile, front to back, until all samples of a tile are covered."""
    tiles = owner.shape[0] // TILE
    start, index = list_tiles(edges, boxes, tiles)
    covered, seen = np.empty(TILE, np.uint32), np.empty(TILE, np.uint32)
    for tile in range(tiles * tiles):
        row, column = tile // tiles, tile % tiles
        covered[:] = 0
        for entry in range(start[tile + 1] - 1, start[tile] - 1, -1):
            t = index[entry]
            _see(edges, boxes, t, column, row, covered, seen)
            for j in range(TILE):
                if seen[j]:
                    _write(owner[row * TILE + j, column * TILE : (column + 1) * TILE], seen[j], t)
            if covered.min() == _ONES:
                break


@compiled
def _add(sums, word, color):
    """Add a colour to the pixels of a row `sums [pixels, 3]`, for each sample of the word."""
    for x in range(TILE // RATE):
        bits = (word >> np.uint32(RATE * x)) & np.uint32(len(_COUNT) - 1)
        if bits:
            for k in range(3):
                sums[x, k] += _COUNT[bits] * color[k]


@compiled
def tile_lists_counted(edges, boxes, colors, background, image):
    """Like `tile_lists`, but counts bits and adds colours to the image, without storing samples."""
    side = TILE // RATE
    tiles = image.shape[0] // side
    start, index = list_tiles(edges, boxes, tiles)
    covered, seen = np.empty(TILE, np.uint32), np.empty(TILE, np.uint32)
    image[:] = 0
    for tile in range(tiles * tiles):
        row, column = tile // tiles, tile % tiles
        covered[:] = 0
        pixels = image[row * side : (row + 1) * side, column * side : (column + 1) * side]
        for entry in range(start[tile + 1] - 1, start[tile] - 1, -1):
            t = index[entry]
            _see(edges, boxes, t, column, row, covered, seen)
            for j in range(TILE):
                if seen[j]:
                    _add(pixels[j // RATE], seen[j], colors[t])
            if covered.min() == _ONES:
                break
        for j in range(TILE):
            if covered[j] != _ONES:
                _add(pixels[j // RATE], ~covered[j], background)
        for y in range(side):
            for x in range(side):
                for k in range(3):
                    pixels[y, x, k] *= np.float32(1 / RATE**2)


@compiled
def resolve(owner, colors, background, image):
    """Average the colours of the samples of each pixel of `image [size, size, 3]`."""
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            red = green = blue = np.float32(0)
            for j in range(y * RATE, (y + 1) * RATE):
                for i in range(x * RATE, (x + 1) * RATE):
                    t = owner[j, i]
                    color = background if t < 0 else colors[t]
                    red, green, blue = red + color[0], green + color[1], blue + color[2]
            scale = np.float32(1 / RATE**2)
            image[y, x, 0], image[y, x, 1], image[y, x, 2] = (
                red * scale,
                green * scale,
                blue * scale,
            )
