// The loop of embree_peers.py in C++: what it costs to call Embree from Numba is the ratio of the two.
//
//     embree_loop FOLDER THREADS
//
// FOLDER holds raw float32: spheres (n, 4: position and radius), normals (n, 3), origins (m, 3), directions (m, 3).
// For each word on standard input, "singles" or "packets", all rays are traced once and a line is printed:
// milliseconds, milliseconds of all processors, number of hits, mean distance of the hits. embree_shim.py takes the medians.

#include <embree3/rtcore.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <thread>
#include <vector>

using Floats = std::vector<float>;

constexpr size_t TILE = 1024;  // rays that a thread takes at a time, as in embree_peers.py
constexpr float INF = std::numeric_limits<float>::infinity();

Floats read(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  Floats out(size_t(file.tellg()) / sizeof(float));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(out.data()), std::streamsize(out.size() * sizeof(float)));
  if (!file) { std::fprintf(stderr, "cannot read %s\n", path.c_str()); std::exit(1); }
  return out;
}

RTCScene build(const Floats& spheres, const Floats& normals) {
  RTCDevice device = rtcNewDevice("");
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_NONE);
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
  RTCGeometry discs = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_ORIENTED_DISC_POINT);
  rtcSetGeometryBuildQuality(discs, RTC_BUILD_QUALITY_HIGH);
  const size_t n = normals.size() / 3;
  std::memcpy(rtcSetNewGeometryBuffer(discs, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, 16, n),
              spheres.data(), 16 * n);
  std::memcpy(rtcSetNewGeometryBuffer(discs, RTC_BUFFER_TYPE_NORMAL, 0, RTC_FORMAT_FLOAT3, 12, n),
              normals.data(), 12 * n);
  rtcCommitGeometry(discs);
  rtcAttachGeometry(scene, discs);
  rtcCommitScene(scene);
  return scene;
}

struct Rays {
  Floats origins, directions, t;
};

void singles(RTCScene scene, Rays& rays, size_t begin, size_t end) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  RTCRayHit r{};
  r.ray.mask = ~0u;
  for (size_t i = begin; i < end; i++) {
    const float *o = &rays.origins[3 * i], *d = &rays.directions[3 * i];
    r.ray.org_x = o[0], r.ray.org_y = o[1], r.ray.org_z = o[2];
    r.ray.dir_x = d[0], r.ray.dir_y = d[1], r.ray.dir_z = d[2];
    r.ray.tfar = INF;
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene, &context, &r);
    rays.t[i] = r.ray.tfar;
  }
}

void packets(RTCScene scene, Rays& rays, size_t begin, size_t end) {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  RTCRayHit16 r{};
  alignas(64) int valid[16];
  for (int k = 0; k < 16; k++) r.ray.mask[k] = ~0u;
  for (size_t first = begin; first < end; first += 16) {
    const size_t count = std::min<size_t>(16, end - first);
    for (size_t k = 0; k < 16; k++) valid[k] = k < count ? -1 : 0;
    for (size_t k = 0; k < count; k++) {
      const float *o = &rays.origins[3 * (first + k)], *d = &rays.directions[3 * (first + k)];
      r.ray.org_x[k] = o[0], r.ray.org_y[k] = o[1], r.ray.org_z[k] = o[2];
      r.ray.dir_x[k] = d[0], r.ray.dir_y[k] = d[1], r.ray.dir_z[k] = d[2];
      r.ray.tfar[k] = INF;
      r.hit.geomID[k] = RTC_INVALID_GEOMETRY_ID;
    }
    rtcIntersect16(valid, scene, &context, &r);
    std::memcpy(&rays.t[first], r.ray.tfar, 4 * count);
  }
}

struct Cost {
  double wall, cpu;  // milliseconds
};

Cost frame(RTCScene scene, Rays& rays, bool in_packets, int threads) {
  const std::clock_t cpu = std::clock();  // of the process: all its threads
  const auto wall = std::chrono::steady_clock::now();
  std::atomic<size_t> next{0};
  const size_t total = rays.t.size();
  std::vector<std::thread> workers;
  for (int k = 0; k < threads; k++)
    workers.emplace_back([&] {
      for (size_t begin; (begin = TILE * next++) < total;)
        (in_packets ? packets : singles)(scene, rays, begin, std::min(begin + TILE, total));
    });
  for (auto& worker : workers) worker.join();
  const std::chrono::duration<double, std::milli> passed = std::chrono::steady_clock::now() - wall;
  return {passed.count(), 1e3 * double(std::clock() - cpu) / CLOCKS_PER_SEC};
}

int main(int count, char** words) {
  if (count != 3) { std::fprintf(stderr, "usage: embree_loop FOLDER THREADS\n"); return 2; }
  const std::string folder = std::string(words[1]) + "/";
  RTCScene scene = build(read(folder + "spheres"), read(folder + "normals"));
  Rays rays{read(folder + "origins"), read(folder + "directions"), {}};
  rays.t.resize(rays.origins.size() / 3);
  for (std::string kind; std::cin >> kind;) {
    const Cost cost = frame(scene, rays, kind == "packets", std::atoi(words[2]));
    size_t hits = 0;
    double sum = 0;
    for (float t : rays.t)
      if (std::isfinite(t)) hits++, sum += t;
    std::printf("%.4f %.4f %zu %.9g\n", cost.wall, cost.cpu, hits, sum / double(hits));
    std::fflush(stdout);
  }
}
