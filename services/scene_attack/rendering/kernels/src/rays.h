// Packets of rays, one to a lane, that run through trees of bounding boxes around an image's triangles.

#pragma once

#include <numeric>

#include "lanes.h"

namespace {

typedef float F;
typedef V<F> Vec;
typedef I<F> Mask;
constexpr int N = Lanes<F>::count;
constexpr int LEAF = 4, BINS = 16, DEEPEST = 64;
constexpr F FAR = 3e38f;
constexpr F FLAT = 1e-20f;  // |det| of a ray and a triangle below which it runs along it

struct Box {
    F low[3] = {FAR, FAR, FAR}, high[3] = {-FAR, -FAR, -FAR};

    void add(const F *p) {
        for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
    }
    void add(const Box &b) { add(b.low), add(b.high); }
    F area() const {
        F x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
        return x < 0 ? 0 : x * y + y * z + z * x;
    }
};

struct Node {
    Box box;
    int32_t first, count;  // of a leaf its triangles; of another node count is 0, and its second child is at `first`
};

// Trees of bounding boxes, one for each object, split where the surface area heuristic says (Wald 2007).
struct Tree {
    std::vector<Node> nodes;
    std::vector<int32_t> order;
    std::vector<F> corners;  // [triangles, 9] in the order of the leaves
    std::vector<int32_t> roots, owners;  // of each object that has triangles its root, and its index

    // Triangles [ends[objects], 3, 3]; those of object k are the ones from ends[k] to ends[k + 1].
    Tree(int64_t objects, const int64_t *ends, const F *given) : order(ends[objects]) {
        const int64_t count = ends[objects];
        std::iota(order.begin(), order.end(), 0);
        std::vector<Box> boxes(count);
        for (int64_t i = 0; i < count; ++i)
            for (int v = 0; v < 3; ++v) boxes[i].add(given + 9 * i + 3 * v);
        nodes.reserve(2 * count + 1);
        for (int64_t k = 0; k < objects; ++k) {
            if (ends[k] == ends[k + 1]) continue;
            roots.push_back((int32_t)nodes.size()), owners.push_back((int32_t)k);
            split(boxes, (int32_t)ends[k], (int32_t)ends[k + 1], 0);
        }
        corners.resize(9 * count);
        for (int64_t i = 0; i < count; ++i) std::memcpy(&corners[9 * i], given + 9 * (int64_t)order[i], 9 * sizeof(F));
    }

    void split(const std::vector<Box> &boxes, int32_t first, int32_t last, int depth) {
        const size_t here = nodes.size();
        nodes.push_back({});
        Box whole, middles;
        for (int32_t i = first; i < last; ++i) {
            const Box &b = boxes[order[i]];
            F m[3];
            for (int k = 0; k < 3; ++k) m[k] = b.low[k] + b.high[k];
            whole.add(b), middles.add(m);
        }
        nodes[here].box = whole;
        int axis = 0;
        for (int k = 1; k < 3; ++k)
            if (middles.high[k] - middles.low[k] > middles.high[axis] - middles.low[axis]) axis = k;
        const F low = middles.low[axis], extent = middles.high[axis] - low;
        if (last - first <= LEAF || !(extent > 0) || depth >= DEEPEST) {
            nodes[here].first = first, nodes[here].count = last - first;
            return;
        }
        auto bin = [&](int32_t i) {
            const Box &b = boxes[i];
            return std::min(BINS - 1, (int)((b.low[axis] + b.high[axis] - low) / extent * BINS));
        };
        Box of[BINS];
        int32_t counts[BINS] = {};
        for (int32_t i = first; i < last; ++i) of[bin(order[i])].add(boxes[order[i]]), ++counts[bin(order[i])];
        F cost[BINS] = {}, best = FAR;
        Box after;
        int32_t n = 0;
        for (int b = BINS - 1; b > 0; --b) after.add(of[b]), n += counts[b], cost[b] = n * after.area();
        Box before;
        int cut = BINS / 2;
        n = 0;
        for (int b = 1; b < BINS; ++b) {
            before.add(of[b - 1]), n += counts[b - 1];
            if (n && n < last - first && cost[b] + n * before.area() < best) best = cost[b] + n * before.area(), cut = b;
        }
        auto middle = std::stable_partition(order.begin() + first, order.begin() + last, [&](int32_t i) { return bin(i) < cut; });
        const int32_t where = (int32_t)(middle - order.begin());
        split(boxes, first, where, depth + 1);
        nodes[here].first = (int32_t)nodes.size(), nodes[here].count = 0;
        split(boxes, where, last, depth + 1);
    }
};

inline bool any(Mask m) {
    int64_t words[BYTES / 8], found = 0;  // by way of memory: lane by lane takes three times as long
    std::memcpy(words, &m, BYTES);
    for (int64_t word : words) found |= word;
    return found != 0;
}

struct Packet {
    Vec o[3], d[3], inverse[3], nearest;  // origins, directions, their reciprocals, distance of the nearest hit
    Mask running;                         // rays that still look for one

    void aim(int lane, const F *direction) {
        for (int k = 0; k < 3; ++k) {
            F c = direction[k];
            d[k][lane] = c, inverse[k][lane] = 1 / (std::abs(c) > 1e-20f ? c : std::copysign(1e-20f, c));
        }
    }

    void aim(const F *direction) {
        for (int k = 0; k < 3; ++k) {
            const F c = direction[k];
            d[k] = all<F>(c), inverse[k] = all<F>(1 / (std::abs(c) > 1e-20f ? c : std::copysign(1e-20f, c)));
        }
    }

    // Stops the rays, of unit directions, that start outside of a ball, centre and radius, and run through it.
    void stop_at(const F *ball) {
        const Vec x = ball[0] - o[0], y = ball[1] - o[1], z = ball[2] - o[2];
        const Vec along = x * d[0] + y * d[1] + z * d[2], distance = x * x + y * y + z * z;
        const F square = ball[3] * ball[3];
        running &= ~((along > F(0)) & (distance > square) & (distance - along * along < square));
    }

    Mask meets(const Box &b) const {
        Vec from{}, to = nearest;
        for (int k = 0; k < 3; ++k) {
            Vec one = (b.low[k] - o[k]) * inverse[k], other = (b.high[k] - o[k]) * inverse[k];
            from = most<F>(from, least<F>(one, other)), to = least<F>(to, most<F>(one, other));
        }
        return (from <= to) & running;
    }

    // Lanes whose rays meet a triangle before `nearest`, and where (Möller and Trumbore 1997).
    Mask meets(const F *c, Vec &distance) const {
        F e[3], g[3];
        for (int k = 0; k < 3; ++k) e[k] = c[3 + k] - c[k], g[k] = c[6 + k] - c[k];
        Vec px = d[1] * g[2] - d[2] * g[1], py = d[2] * g[0] - d[0] * g[2], pz = d[0] * g[1] - d[1] * g[0];
        Vec det = px * e[0] + py * e[1] + pz * e[2];
        Mask flat = (det < FLAT) & (det > -FLAT);
        Vec scale = F(1) / choose<F>(flat, all<F>(1), det);
        Vec x = o[0] - c[0], y = o[1] - c[1], z = o[2] - c[2];
        Vec u = (x * px + y * py + z * pz) * scale;
        Vec qx = y * e[2] - z * e[1], qy = z * e[0] - x * e[2], qz = x * e[1] - y * e[0];
        Vec v = (d[0] * qx + d[1] * qy + d[2] * qz) * scale;
        distance = (qx * g[0] + qy * g[1] + qz * g[2]) * scale;
        return ~flat & (u >= F(0)) & (v >= F(0)) & (u + v <= F(1)) & (distance > F(0)) & (distance < nearest) & running;
    }

    // Runs the rays through the tree below the node `root`; with `first` a ray stops at any hit, else at the nearest,
    // whose face it notes.
    void run(const Tree &tree, int32_t root, bool first, int32_t *faces) {
        int32_t stack[2 * DEEPEST + 4];
        int top = 0;
        stack[top++] = root;
        while (top) {
            const int32_t at = stack[--top];
            const Node &node = tree.nodes[at];
            if (!any(meets(node.box))) continue;
            if (!node.count) {
                stack[top++] = node.first, stack[top++] = at + 1;
                continue;
            }
            for (int32_t i = node.first; i < node.first + node.count; ++i) {
                Vec distance;
                Mask hit = meets(&tree.corners[9 * (int64_t)i], distance);
                if (!any(hit)) continue;
                nearest = choose<F>(hit, distance, nearest);
                if (first) {
                    running &= ~hit;
                    if (!any(running)) return;
                } else {
                    for (int l = 0; l < N; ++l)
                        if (hit[l]) faces[l] = tree.order[i];
                }
            }
        }
    }
};

}  // namespace
