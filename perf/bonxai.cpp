// Bonxai's probabilistic map behind C functions, for map_peers.py.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "bonxai_map/probabilistic_map.hpp"

using Map = Bonxai::ProbabilisticMap;

namespace {
struct Held {
  explicit Held(double resolution) : map(resolution) {}
  Map map;
  std::vector<Map::Vector3D> points;
};
}  // namespace

extern "C" {

void* bonxai_new(double resolution) { return new Held(resolution); }

void bonxai_delete(void* held) { delete static_cast<Held*>(held); }

// A frame of depth in millimetres, 0 for none. `pinhole` is fx, fy, cx, cy; `rotation` (row by row) and `origin` are
// T_world_camera; valid depths lie between `least` and `greatest` metres.
void bonxai_insert(void* pointer, const std::uint16_t* depth, int width, int height, const double* pinhole,
                   const double* rotation, const double* origin, double least, double greatest, double range) {
  auto& held = *static_cast<Held*>(pointer);
  held.points.clear();
  for (int v = 0; v < height; ++v) {
    const double b = (v + 0.5 - pinhole[3]) / pinhole[1];
    for (int u = 0; u < width; ++u) {
      const double z = 1e-3 * *depth++;
      if (!(z >= least && z <= greatest)) {
        continue;
      }
      const double x = z * (u + 0.5 - pinhole[2]) / pinhole[0], y = z * b;
      held.points.emplace_back(rotation[0] * x + rotation[1] * y + rotation[2] * z + origin[0],
                               rotation[3] * x + rotation[4] * y + rotation[5] * z + origin[1],
                               rotation[6] * x + rotation[7] * y + rotation[8] * z + origin[2]);
    }
  }
  held.map.insertPointCloud(held.points, Map::Vector3D(origin[0], origin[1], origin[2]), range);
}

// The number of occupied (state 1) or free (state 0) voxels; their integer coordinates too, where there is room.
std::size_t bonxai_voxels(void* pointer, int state, std::int32_t* coordinates) {
  auto& map = static_cast<Held*>(pointer)->map;
  std::vector<Bonxai::CoordT> found;
  if (state == 1) {
    map.getOccupiedVoxels(found);
  } else {
    map.getFreeVoxels(found);
  }
  if (coordinates != nullptr) {
    for (const auto& coord : found) {
      *coordinates++ = coord.x;
      *coordinates++ = coord.y;
      *coordinates++ = coord.z;
    }
  }
  return found.size();
}

std::size_t bonxai_memory(void* pointer) { return static_cast<Held*>(pointer)->map.grid().memUsage(); }
}
