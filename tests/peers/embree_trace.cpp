// embree_trace: what Embree reaches on an OBJ, stage by stage, as JSON lines.
//
//   embree_trace MESH.obj [--eye X Y Z --look X Y Z --up X Y Z --fov DEG] [--size W H] [--light X Y Z]
//     [--quality low|medium|high] [--robust] [--compact] [--threads 1,2] [--build-threads N]
//     [--repeat R] [--build-repeat R] [--chords N] [--dump-depth F] [--dump-prim F] [--dump-chords F]
//     [--frame F.ppm] [--no-trace] [--tag TEXT] [--dump-rays PREFIX] [--dump-mesh F]
//     [--rays F --hits F [--any]] [--serve [--packet]]
//
// Conventions another program must copy to be compared pixel by pixel:
//   f = norm(look - eye); r = norm(f x up); u = r x f;  pixel (x, y) with y = 0 at the top;
//   sx = (2 (x + .5) / W - 1) tan(fov / 2) W / H;  sy = (1 - 2 (y + .5) / H) tan(fov / 2);
//   dir = norm(f + sx r + sy u) in double, then cast to float; fov is vertical, in degrees.
//   Depth dump: W*H float32, row-major from the top, the distance t along the unit dir; -1 = miss.
//   Primitive dump: W*H uint32, the triangle's number in file order (fans count); ~0 = miss.
//   Shadow ray: from P + 1e-5 D n toward the light, D = diagonal of the bounding box, n = geometric
//   normal turned to the viewer, ends at the light.  Reflection: same origin, norm(d - 2 (d.n) n).
//   Chords: SplitMix64 seeded with 42, four uniforms a ray (53 bits): z = 2 u - 1, phi = 2 pi u for the
//   origin, the same for the far point, both on the sphere about the box's centre with radius D / 2.
// --dump-rays writes PREFIX.{primary,shadow,reflect,chords}.rays (8 float32 a ray: origin, direction, tmin, tmax)
//   and PREFIX.*.t (float32; -1 = miss; for shadow 1 = blocked, 0 = free), so that another tracer can be fed the
//   very same rays; --dump-mesh writes u64 vertices, u64 triangles, float32 xyz..., uint32 abc....
// --rays traces the rays of a file, 8 float32 each (origin, direction, tmin, tmax), one by one (rtcIntersect1, with
//   --any rtcOccluded1), and nothing else; --hits writes 16 bytes a ray: float32 t, uint32 triangle, float32 u, v; a miss
//   has t = infinity and triangle = ~0; with --any one byte a ray, 1 = blocked.
// --serve keeps the mesh and answers requests from standard input, for `octbench speed --peer-command`: see serve() below.
// Rays lie in memory in 32 x 32 tiles of 4 x 4 blocks, so 16 neighbours are a 4 x 4 block.  Only the
// trace calls (with the copy of the ray from its array) are timed, never the ray generation; --frame
// times a whole Whitted frame, generation and shading included.
//
// Build (Embree 4): g++ -O3 -march=native -std=c++17 -o embree_trace embree_trace.cpp -lembree4 -pthread
//   or with the library of the PyPI wheel embreex (pip download embreex --no-deps; unzip; L = embreex.libs; ln -s its
//   libembree4-*.so.4 $L/libembree4.so) and the headers of Embree's include/embree4:
//   g++ -O3 -march=native -std=c++17 -Iinclude -o embree_trace embree_trace.cpp -L$L -lembree4 -Wl,-rpath,$L -Wl,-rpath-link,$L -pthread
// Build (Embree 3): g++ -O3 -march=native -std=c++17 -DEMBREE3 -o embree_trace3 embree_trace.cpp -lembree3 -pthread
#ifdef EMBREE3
#include <embree3/rtcore.h>
#else
#include <embree4/rtcore.h>
#endif
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>
#include <thread>
#include <vector>

using Clock = std::chrono::steady_clock;
static double cpuSeconds() { timespec t; clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t); return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec; }
static double since(Clock::time_point t) { return std::chrono::duration<double>(Clock::now() - t).count(); }
static long statusKb(const char* key) {
  FILE* f = fopen("/proc/self/status", "r"); char l[256]; long v = -1;
  while (f && fgets(l, sizeof l, f)) if (!strncmp(l, key, strlen(key))) v = atol(l + strlen(key) + 1);
  if (f) fclose(f);
  return v;
}
static double median(std::vector<double> v) { std::sort(v.begin(), v.end()); size_t n = v.size(); return n & 1 ? v[n / 2] : .5 * (v[n / 2 - 1] + v[n / 2]); }

// An array that grows without ever being copied: address space is reserved, pages come as written.
template <class T> struct Grow {
  T* p = nullptr; size_t n = 0, cap = 0;
  void reserve(size_t c) {
    cap = c; p = (T*)mmap(nullptr, c * sizeof(T), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (p == MAP_FAILED) { perror("mmap"); exit(1); }
  }
  void push(T v) { if (n == cap) { fprintf(stderr, "mesh too large\n"); exit(1); } p[n++] = v; }
};

struct Mesh { Grow<float> v; Grow<uint32_t> f; double lo[3], hi[3], parse = 0; size_t bytes = 0; };

static inline const char* num(const char* s, double& out) {
  while (*s == ' ' || *s == '\t') s++;
  bool neg = *s == '-'; if (*s == '-' || *s == '+') s++;
  uint64_t m = 0; int e = 0, digits = 0;
  for (; *s >= '0' && *s <= '9'; s++) if (digits < 18) { m = m * 10 + (uint64_t)(*s - '0'); digits += m != 0; } else e++;
  if (*s == '.') for (s++; *s >= '0' && *s <= '9'; s++) if (digits < 18) { m = m * 10 + (uint64_t)(*s - '0'); digits += m != 0; e--; }
  if (*s == 'e' || *s == 'E') { s++; bool en = *s == '-'; if (*s == '-' || *s == '+') s++; int x = 0; for (; *s >= '0' && *s <= '9'; s++) x = x * 10 + (*s - '0'); e += en ? -x : x; }
  static const double p[] = {1, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  double d = (double)m; d = e == 0 ? d : e < 0 && e >= -22 ? d / p[-e] : e > 0 && e <= 22 ? d * p[e] : d * std::pow(10.0, e);
  out = neg ? -d : d; return s;
}

static void parseObj(const char* path, Mesh& m) {
  auto t0 = Clock::now();
  int fd = open(path, O_RDONLY); if (fd < 0) { perror(path); exit(1); }
  posix_fadvise(fd, 0, 0, POSIX_FADV_SEQUENTIAL);
  m.v.reserve((size_t)3 << 31); m.f.reserve((size_t)3 << 31);
  for (int a = 0; a < 3; a++) { m.lo[a] = 1e300; m.hi[a] = -1e300; }
  const size_t CH = 4 << 20; std::vector<char> buf(2 * CH + 1); size_t have = 0; bool eof = false;
  while (!eof || have) {
    while (have < CH && !eof) { ssize_t r = read(fd, buf.data() + have, CH); if (r < 0) { perror(path); exit(1); } if (r == 0) eof = true; have += (size_t)r; m.bytes += (size_t)r; }
    char* end = buf.data() + have; char* stop = end;
    if (eof) { if (have && end[-1] != '\n') { *end++ = '\n'; stop = end; } }
    else { while (stop > buf.data() && stop[-1] != '\n') stop--; if (stop == buf.data()) { fprintf(stderr, "line too long\n"); exit(1); } }
    for (char* s = buf.data(); s < stop;) {
      while (*s == ' ' || *s == '\t') s++;
      if (s[0] == 'v' && (s[1] == ' ' || s[1] == '\t')) {
        const char* q = s + 1; for (int a = 0; a < 3; a++) { double d; q = num(q, d); float x = (float)d; m.v.push(x); if (x < m.lo[a]) m.lo[a] = x; if (x > m.hi[a]) m.hi[a] = x; }
        s = (char*)q;
      } else if (s[0] == 'f' && (s[1] == ' ' || s[1] == '\t')) {
        char* q = s + 1; uint32_t first = 0, prev = 0; int k = 0;
        for (;;) {
          while (*q == ' ' || *q == '\t' || *q == '\r') q++;
          if (*q == '\n') break;
          bool neg = *q == '-'; if (neg) q++;
          int64_t i = 0; char* q0 = q; for (; *q >= '0' && *q <= '9'; q++) i = i * 10 + (*q - '0');
          if (q == q0) break;
          uint32_t id = (uint32_t)(neg ? (int64_t)(m.v.n / 3) - i : i - 1);
          while (*q != ' ' && *q != '\n' && *q != '\t') q++;
          if (k == 0) first = id; else if (k >= 2) { m.f.push(first); m.f.push(prev); m.f.push(id); }
          prev = id; k++;
        }
        s = q;
      }
      s = (char*)memchr(s, '\n', (size_t)(stop - s)) + 1;
    }
    have = (size_t)(end - stop); memmove(buf.data(), stop, have);
    if (eof && stop == end) have = 0;
  }
  close(fd);
  m.parse = since(t0);
}

struct V3 { double x, y, z; };
static V3 operator+(V3 a, V3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
static V3 operator-(V3 a, V3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
static V3 operator*(double s, V3 a) { return {s * a.x, s * a.y, s * a.z}; }
static double dot(V3 a, V3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static V3 cross(V3 a, V3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
static V3 norm(V3 a) { return (1 / std::sqrt(dot(a, a))) * a; }

struct Ray { float o[3], d[3], tfar; };
struct Hit { float t; uint32_t prim; float n[3]; };

static std::atomic<int64_t> memNow{0}, memPeak{0};
static bool memFn(void*, ssize_t b, bool) { int64_t v = memNow += b, p = memPeak; while (v > p && !memPeak.compare_exchange_weak(p, v)) {} return true; }

static RTCScene scene;
static bool robust_;
static inline void isect(RTCRayHit& rh) {
#ifdef EMBREE3
  RTCIntersectContext c; rtcInitIntersectContext(&c); rtcIntersect1(scene, &c, &rh);
#else
  rtcIntersect1(scene, &rh, nullptr);
#endif
}
static inline bool occl(const Ray& r) {
  RTCRay q; q.org_x = r.o[0]; q.org_y = r.o[1]; q.org_z = r.o[2]; q.dir_x = r.d[0]; q.dir_y = r.d[1]; q.dir_z = r.d[2];
  q.tnear = 0; q.tfar = r.tfar; q.time = 0; q.mask = ~0u; q.id = 0; q.flags = 0;
#ifdef EMBREE3
  RTCIntersectContext c; rtcInitIntersectContext(&c); rtcOccluded1(scene, &c, &q);
#else
  rtcOccluded1(scene, &q, nullptr);
#endif
  return q.tfar < 0;
}
static inline void load(RTCRayHit& h, const Ray& r) {
  h.ray.org_x = r.o[0]; h.ray.org_y = r.o[1]; h.ray.org_z = r.o[2]; h.ray.dir_x = r.d[0]; h.ray.dir_y = r.d[1]; h.ray.dir_z = r.d[2];
  h.ray.tnear = 0; h.ray.tfar = r.tfar; h.ray.time = 0; h.ray.mask = ~0u; h.ray.id = 0; h.ray.flags = 0;
  h.hit.geomID = RTC_INVALID_GEOMETRY_ID; h.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
}
static inline Hit trace1(const Ray& r) {
  RTCRayHit h; load(h, r); isect(h);
  if (h.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {-1, ~0u, {0, 0, 0}};
  return {h.ray.tfar, h.hit.primID, {h.hit.Ng_x, h.hit.Ng_y, h.hit.Ng_z}};
}
template <int N> struct Pk;
template <> struct Pk<8> { using T = RTCRayHit8; static void go(const int* m, T* p) {
#ifdef EMBREE3
  RTCIntersectContext c; rtcInitIntersectContext(&c); c.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT; rtcIntersect8(m, scene, &c, p);
#else
  RTCIntersectArguments a; rtcInitIntersectArguments(&a); a.flags = RTC_RAY_QUERY_FLAG_COHERENT; rtcIntersect8(m, scene, p, &a);
#endif
} };
template <> struct Pk<16> { using T = RTCRayHit16; static void go(const int* m, T* p) {
#ifdef EMBREE3
  RTCIntersectContext c; rtcInitIntersectContext(&c); c.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT; rtcIntersect16(m, scene, &c, p);
#else
  RTCIntersectArguments a; rtcInitIntersectArguments(&a); a.flags = RTC_RAY_QUERY_FLAG_COHERENT; rtcIntersect16(m, scene, p, &a);
#endif
} };
template <int N> static void tracePacket(const Ray* r, float* t) {
  alignas(64) typename Pk<N>::T p; alignas(64) int m[N];
  for (int i = 0; i < N; i++) {
    m[i] = -1; p.ray.org_x[i] = r[i].o[0]; p.ray.org_y[i] = r[i].o[1]; p.ray.org_z[i] = r[i].o[2]; p.ray.dir_x[i] = r[i].d[0]; p.ray.dir_y[i] = r[i].d[1]; p.ray.dir_z[i] = r[i].d[2];
    p.ray.tnear[i] = 0; p.ray.tfar[i] = r[i].tfar; p.ray.time[i] = 0; p.ray.mask[i] = ~0u; p.ray.id[i] = 0; p.ray.flags[i] = 0; p.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID; p.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
  }
  Pk<N>::go(m, &p);
  for (int i = 0; i < N; i++) t[i] = p.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID ? -1 : p.ray.tfar[i];
}

// work(begin, end) over [0, n) in chunks of 1024, on T threads; seconds taken
static double parallel(size_t n, int T, const std::function<void(size_t, size_t)>& work) {
  std::atomic<size_t> next{0};
  auto body = [&] { for (;;) { size_t b = next.fetch_add(1024); if (b >= n) return; work(b, std::min(n, b + 1024)); } };
  auto t0 = Clock::now();
  std::vector<std::thread> th; for (int i = 1; i < T; i++) th.emplace_back(body);
  body(); for (auto& t : th) t.join();
  return since(t0);
}
static uint64_t sm(uint64_t& s) { uint64_t z = (s += 0x9e3779b97f4a7c15ull); z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull; z = (z ^ (z >> 27)) * 0x94d049bb133111ebull; return z ^ (z >> 31); }
// The rays of a file, traced one by one; times on standard output, hits to a file.
static int traceFile(const char* rayFile, const char* hitFile, bool any, const std::vector<int>& threads, int repeat, const char* tag, const char* base) {
  struct In { float o[3], d[3], tmin, tmax; }; struct Out { float t; uint32_t prim; float u, v; };
  FILE* f = fopen(rayFile, "rb"); if (!f) { perror(rayFile); return 1; }
  fseek(f, 0, SEEK_END); size_t n = (size_t)ftell(f) / sizeof(In); rewind(f);
  std::vector<In> in(n); if (fread(in.data(), sizeof(In), n, f) != n) { perror(rayFile); return 1; } fclose(f);
  std::vector<Out> out(any ? 0 : n); std::vector<uint8_t> occ(any ? n : 0);
  auto work = [&](size_t b, size_t e) {
    for (; b < e; b++) {
      const In& r = in[b]; RTCRayHit h; load(h, Ray{{r.o[0], r.o[1], r.o[2]}, {r.d[0], r.d[1], r.d[2]}, r.tmax}); h.ray.tnear = r.tmin;
      if (any) {
#ifdef EMBREE3
        RTCIntersectContext c; rtcInitIntersectContext(&c); rtcOccluded1(scene, &c, &h.ray);
#else
        rtcOccluded1(scene, &h.ray, nullptr);
#endif
        occ[b] = h.ray.tfar < 0;
      } else {
        isect(h); bool hit = h.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        out[b] = hit ? Out{h.ray.tfar, h.hit.primID, h.hit.u, h.hit.v} : Out{INFINITY, ~0u, 0, 0};
      }
    }
  };
  for (int T : threads) {
    std::vector<double> s; for (int k = 0; k < repeat + 1; k++) { double d = parallel(n, T, work); if (k) s.push_back(d); }
    size_t hits = 0; if (any) for (auto v : occ) hits += v; else for (auto& o : out) hits += o.prim != ~0u;
    printf("{\"stage\":\"rays\",\"tag\":\"%s\",\"mesh\":\"%s\",\"robust\":%d,\"any\":%d,\"threads\":%d,\"rays\":%zu,\"hits\":%zu,\"runs\":%zu,\"ms\":%.3f,\"Mrays_s\":%.3f}\n", tag, base, (int)robust_, (int)any, T, n, hits, s.size(), median(s) * 1e3, (double)n / 1e6 / median(s));
  }
  if (hitFile) { f = fopen(hitFile, "wb"); bool ok = f && (any ? fwrite(occ.data(), 1, n, f) == n : fwrite(out.data(), sizeof(Out), n, f) == n); if (!ok || fclose(f)) { perror(hitFile); return 1; } }
  return 0;
}
struct Ray8 { float o[3], d[3], tmin, tmax; };
static bool readRays(const char* path, std::vector<Ray8>& rays) {
  FILE* f = fopen(path, "rb"); if (!f) { perror(path); return false; }
  fseek(f, 0, SEEK_END); rays.resize((size_t)ftell(f) / sizeof(Ray8)); rewind(f);
  bool ok = fread(rays.data(), sizeof(Ray8), rays.size(), f) == rays.size(); fclose(f);
  if (!ok) perror(path);
  return ok;
}
static inline void setRay(RTCRayHit& h, const Ray8& r) { load(h, Ray{{r.o[0], r.o[1], r.o[2]}, {r.d[0], r.d[1], r.d[2]}, r.tmax}); h.ray.tnear = r.tmin; }
struct Hit16 { float t; uint32_t prim; float u, v; };
static inline Hit16 closest1(const Ray8& r) {
  RTCRayHit h; setRay(h, r); isect(h);
  return h.hit.geomID == RTC_INVALID_GEOMETRY_ID ? Hit16{INFINITY, ~0u, 0, 0} : Hit16{h.ray.tfar, h.hit.primID, h.hit.u, h.hit.v};
}
static inline bool any1(const Ray8& r) {
  RTCRayHit h; setRay(h, r);
#ifdef EMBREE3
  RTCIntersectContext c; rtcInitIntersectContext(&c); rtcOccluded1(scene, &c, &h.ray);
#else
  rtcOccluded1(scene, &h.ray, nullptr);
#endif
  return h.ray.tfar < 0;
}
// Up to 16 rays at once, told to be coherent: hits, or for `any` whether each is blocked.
static void sixteen(const Ray8* r, size_t n, bool any, Hit16* hits, uint8_t* blocked) {
  alignas(64) RTCRayHit16 p; alignas(64) int m[16];
  for (size_t i = 0; i < 16; i++) {
    const Ray8& q = r[i < n ? i : 0]; m[i] = i < n ? -1 : 0;
    p.ray.org_x[i] = q.o[0]; p.ray.org_y[i] = q.o[1]; p.ray.org_z[i] = q.o[2]; p.ray.dir_x[i] = q.d[0]; p.ray.dir_y[i] = q.d[1]; p.ray.dir_z[i] = q.d[2];
    p.ray.tnear[i] = q.tmin; p.ray.tfar[i] = q.tmax; p.ray.time[i] = 0; p.ray.mask[i] = ~0u; p.ray.id[i] = 0; p.ray.flags[i] = 0; p.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID; p.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
  }
  if (any) {
#ifdef EMBREE3
    RTCIntersectContext c; rtcInitIntersectContext(&c); c.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT; rtcOccluded16(m, scene, &c, &p.ray);
#else
    RTCOccludedArguments a; rtcInitOccludedArguments(&a); a.flags = RTC_RAY_QUERY_FLAG_COHERENT; rtcOccluded16(m, scene, &p.ray, &a);
#endif
    for (size_t i = 0; i < n; i++) blocked[i] = p.ray.tfar[i] < 0;
  } else {
    Pk<16>::go(m, &p);
    for (size_t i = 0; i < n; i++) hits[i] = p.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID ? Hit16{INFINITY, ~0u, 0, 0} : Hit16{p.ray.tfar[i], p.hit.primID[i], p.hit.u[i], p.hit.v[i]};
  }
}
// Requests are lines "closest|any THREADS PATH" of a file of rays; each is traced once and answered with a line of JSON: the
// seconds of tracing alone, those of the processor, and how many rays hit. The rays of the last path are kept, so that repeats read nothing.
// "store PATH" writes the closest hits of the last round, 16 bytes each as with --hits. "frame THREADS" draws a frame as with --frame.
static int serve(const char* name, bool packet, const std::function<double(int)>& frame) {
  printf("{\"peer\":\"%s\"}\n", name); fflush(stdout);
  std::vector<Ray8> rays; std::vector<Hit16> hits; std::vector<uint8_t> blocked; std::string kept; char line[4096 + 64], path[4097], what[16]; int T = 0;
  while (fgets(line, sizeof line, stdin)) {
    if (sscanf(line, "store %4096[^\n]", path) == 1) {
      FILE* f = fopen(path, "wb"); bool ok = f && fwrite(hits.data(), sizeof(Hit16), hits.size(), f) == hits.size(); if (!f || fclose(f) || !ok) { perror(path); return 1; }
      printf("{\"stored\":%zu}\n", hits.size()); fflush(stdout); continue;
    }
    if (sscanf(line, "frame %d", &T) == 1 && T >= 1 && T <= 1024) {
      double c = cpuSeconds(), s = frame(T); printf("{\"frame\":%.9f,\"cpu\":%.9f}\n", s, cpuSeconds() - c); fflush(stdout); continue;
    }
    if (sscanf(line, "%15s %d %4096[^\n]", what, &T, path) != 3 || T < 1 || T > 1024) { fprintf(stderr, "not a request: %s", line); return 2; }
    bool any = !strcmp(what, "any"); if (!any && strcmp(what, "closest")) { fprintf(stderr, "not a request: %s", line); return 2; }
    if (kept != path) { if (!readRays(path, rays)) return 1; kept = path; hits.assign(rays.size(), {}); blocked.assign(rays.size(), 0); }
    double c = cpuSeconds(), s = parallel(rays.size(), T, [&](size_t b, size_t e) {
      if (packet) for (; b < e; b += 16) sixteen(&rays[b], std::min<size_t>(16, e - b), any, &hits[b], &blocked[b]);
      else if (any) for (; b < e; b++) blocked[b] = any1(rays[b]);
      else for (; b < e; b++) hits[b] = closest1(rays[b]);
    });
    c = cpuSeconds() - c;
    size_t count = 0; if (any) for (uint8_t x : blocked) count += x; else for (auto& h : hits) count += h.prim != ~0u;
    printf("{\"round\":%.9f,\"cpu\":%.9f,\"hits\":%zu}\n", s, c, count); fflush(stdout);
  }
  return 0;
}
using Bytes = std::vector<std::pair<const void*, size_t>>;
static void dumpAll(const std::string& f, const Bytes& parts) {
  FILE* o = fopen(f.c_str(), "wb"); bool ok = o; for (auto& p : parts) ok = ok && fwrite(p.first, 1, p.second, o) == p.second;
  if (!ok || fclose(o)) { perror(f.c_str()); exit(1); }
}
static void dump(const char* f, const void* p, size_t n) { dumpAll(f, {{p, n}}); }
static void dumpSet(const char* prefix, const char* st, const std::vector<Ray>& r, const std::vector<float>& t) {
  if (!prefix) return;
  std::vector<float> eight; eight.reserve(r.size() * 8);
  for (auto& x : r) { eight.insert(eight.end(), x.o, x.o + 3); eight.insert(eight.end(), x.d, x.d + 3); eight.push_back(0); eight.push_back(x.tfar); }
  std::string b = std::string(prefix) + "." + st; dumpAll(b + ".rays", {{eight.data(), eight.size() * 4}}); dumpAll(b + ".t", {{t.data(), t.size() * 4}});
}
static std::vector<float> ts(const std::vector<Hit>& h) { std::vector<float> t(h.size()); for (size_t i = 0; i < h.size(); i++) t[i] = h[i].prim == ~0u ? -1 : h[i].t; return t; }

int main(int argc, char** argv) {
  const char *mesh = nullptr, *quality = "high", *dumpDepth = nullptr, *dumpPrim = nullptr, *dumpChords = nullptr, *dumpRays = nullptr, *dumpMesh = nullptr, *frame = nullptr, *tag = "", *rayFile = nullptr, *hitFile = nullptr;
  V3 eye{0, 0, 3}, look{0, 0, 0}, up{0, 1, 0}, light{5, 5, 5}; double fov = 45; int W = 1024, H = 1024, repeat = 5, buildRepeat = 1, buildThreads = 2; size_t chords = 0;
  std::vector<int> threads{1, 2}; bool compact = false, noTrace = false, any = false, server = false, packet = false;
  for (int i = 1; i < argc; i++) {
    std::string a = argv[i];
    auto need = [&](int k) { if (i + k >= argc) { fprintf(stderr, "%s: too few values\n", a.c_str()); exit(2); } };
    auto v3 = [&](V3& v) { need(3); v = {atof(argv[i + 1]), atof(argv[i + 2]), atof(argv[i + 3])}; i += 3; };
    auto str = [&] { need(1); return argv[++i]; };
    if (a == "--eye") v3(eye); else if (a == "--look") v3(look); else if (a == "--up") v3(up); else if (a == "--light") v3(light);
    else if (a == "--fov") fov = atof(str()); else if (a == "--size") { need(2); W = atoi(argv[i + 1]); H = atoi(argv[i + 2]); i += 2; }
    else if (a == "--quality") quality = str(); else if (a == "--robust") robust_ = true; else if (a == "--compact") compact = true;
    else if (a == "--threads") { threads.clear(); for (char* s = strtok(str(), ","); s; s = strtok(nullptr, ",")) threads.push_back(atoi(s)); }
    else if (a == "--build-threads") buildThreads = atoi(str()); else if (a == "--repeat") repeat = atoi(str()); else if (a == "--build-repeat") buildRepeat = atoi(str());
    else if (a == "--chords") chords = (size_t)atof(str()); else if (a == "--dump-depth") dumpDepth = str(); else if (a == "--dump-prim") dumpPrim = str();
    else if (a == "--dump-chords") dumpChords = str(); else if (a == "--dump-rays") dumpRays = str(); else if (a == "--dump-mesh") dumpMesh = str(); else if (a == "--frame") frame = str(); else if (a == "--no-trace") noTrace = true; else if (a == "--tag") tag = str();
    else if (a == "--rays") rayFile = str(); else if (a == "--hits") hitFile = str(); else if (a == "--any") any = true; else if (a == "--serve") server = true; else if (a == "--packet") packet = true;
    else if (a[0] != '-') mesh = argv[i]; else { fprintf(stderr, "unknown option %s\n", a.c_str()); return 2; }
  }
  if (!mesh || W % 4 || H % 4) { fprintf(stderr, "usage: embree_trace MESH.obj [options]; W and H multiples of 4\n"); return 2; }
  setvbuf(stdout, nullptr, _IOLBF, 0);
  const char* base = strrchr(mesh, '/'); base = base ? base + 1 : mesh;

  Mesh m; parseObj(mesh, m);
  size_t nt = m.f.n / 3, nv = m.v.n / 3;
  if (!nt) { fprintf(stderr, "%s: no triangles\n", mesh); return 1; }
  for (size_t i = 0; i < m.f.n; i++) if (m.f.p[i] >= nv) { fprintf(stderr, "%s: face %zu: index out of range\n", mesh, i / 3); return 1; }
  printf("{\"stage\":\"parse\",\"tag\":\"%s\",\"mesh\":\"%s\",\"triangles\":%zu,\"vertices\":%zu,\"seconds\":%.3f,\"MB_s\":%.0f,\"mesh_MiB\":%.1f,\"rss_MiB\":%.1f,\"box\":[%g,%g,%g,%g,%g,%g]}\n", tag, base, nt, nv, m.parse,
         (double)m.bytes / 1e6 / m.parse, (double)(m.v.n * 4 + m.f.n * 4) / 1048576., (double)statusKb("VmRSS:") / 1024., m.lo[0], m.lo[1], m.lo[2], m.hi[0], m.hi[1], m.hi[2]);

  if (dumpMesh) { uint64_t hd[2] = {nv, nt}; dumpAll(dumpMesh, {{hd, 16}, {m.v.p, m.v.n * 4}, {m.f.p, m.f.n * 4}}); }
  char cfg[64]; snprintf(cfg, sizeof cfg, "threads=%d", buildThreads);
  RTCDevice dev = rtcNewDevice(cfg); if (!dev) { fprintf(stderr, "no device: %d\n", rtcGetDeviceError(nullptr)); return 1; }
  rtcSetDeviceErrorFunction(dev, [](void*, RTCError c, const char* s) { fprintf(stderr, "embree error %d: %s\n", c, s); exit(3); }, nullptr);
  rtcSetDeviceMemoryMonitorFunction(dev, memFn, nullptr);
  RTCBuildQuality q = !strcmp(quality, "high") ? RTC_BUILD_QUALITY_HIGH : !strcmp(quality, "medium") ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_LOW;
  std::vector<double> bt;
  for (int b = 0; b < buildRepeat; b++) {
    if (b) rtcReleaseScene(scene);
    memPeak = (int64_t)memNow;
    auto t0 = Clock::now();
    scene = rtcNewScene(dev);
    rtcSetSceneBuildQuality(scene, q);
    rtcSetSceneFlags(scene, (RTCSceneFlags)((robust_ ? RTC_SCENE_FLAG_ROBUST : 0) | (compact ? RTC_SCENE_FLAG_COMPACT : 0)));
    RTCGeometry g = rtcNewGeometry(dev, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(g, q);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, m.v.p, 0, 12, nv);
    rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, m.f.p, 0, 12, nt);
    rtcCommitGeometry(g); rtcAttachGeometry(scene, g); rtcReleaseGeometry(g);
    rtcCommitScene(scene);
    bt.push_back(since(t0));
  }
  int ver = (int)rtcGetDeviceProperty(dev, RTC_DEVICE_PROPERTY_VERSION);
  printf("{\"stage\":\"build\",\"tag\":\"%s\",\"mesh\":\"%s\",\"embree\":\"%d.%d.%d\",\"quality\":\"%s\",\"robust\":%d,\"compact\":%d,\"threads\":%d,\"runs\":%d,\"seconds\":%.3f,\"min\":%.3f,\"max\":%.3f,\"bvh_MiB\":%.1f,\"bvh_bytes_per_tri\":%.1f,\"alloc_peak_MiB\":%.1f,\"rss_MiB\":%.1f,\"peak_rss_MiB\":%.1f}\n",
         tag, base, ver / 10000, ver / 100 % 100, ver % 100, quality, (int)robust_, (int)compact, buildThreads, buildRepeat, median(bt), *std::min_element(bt.begin(), bt.end()), *std::max_element(bt.begin(), bt.end()),
         (double)memNow / 1048576., (double)memNow / (double)nt, (double)memPeak / 1048576., (double)statusKb("VmRSS:") / 1024., (double)statusKb("VmHWM:") / 1024.);
  if (noTrace) return 0;
  double ex = m.hi[0] - m.lo[0], ey = m.hi[1] - m.lo[1], ez = m.hi[2] - m.lo[2], D = std::sqrt(ex * ex + ey * ey + ez * ez), eps = 1e-5 * D;
  V3 f = norm(look - eye), r = norm(cross(f, up)), u = cross(r, f); double th = std::tan(fov * M_PI / 360);
  size_t N = (size_t)W * (size_t)H;
  std::vector<uint32_t> pix; pix.reserve(N);
  for (int ty = 0; ty < H; ty += 32) for (int tx = 0; tx < W; tx += 32)
    for (int by = ty; by < std::min(H, ty + 32); by += 4) for (int bx = tx; bx < std::min(W, tx + 32); bx += 4)
      for (int y = by; y < by + 4; y++) for (int x = bx; x < bx + 4; x++) pix.push_back((uint32_t)(y * W + x));
  auto dirOf = [&](uint32_t p) { int x = (int)(p % (uint32_t)W), y = (int)(p / (uint32_t)W); double sx = (2 * (x + .5) / W - 1) * th * W / H, sy = (1 - 2 * (y + .5) / H) * th; return norm(f + sx * r + sy * u); };
  auto mk = [](V3 o, V3 d, double t) { return Ray{{(float)o.x, (float)o.y, (float)o.z}, {(float)d.x, (float)d.y, (float)d.z}, (float)t}; };
  auto surface = [&](const Ray& ry, const Hit& h, V3& P, V3& n, V3& d) {
    d = {ry.d[0], ry.d[1], ry.d[2]}; n = norm({h.n[0], h.n[1], h.n[2]}); if (dot(n, d) > 0) n = -1.0 * n;
    P = V3{ry.o[0], ry.o[1], ry.o[2]} + (double)h.t * d + eps * n;
  };
  // A whole Whitted frame: one mirror bounce, a shadow ray at each hit, Blinn-Phong.
  std::vector<uint8_t> img(N * 3);
  std::atomic<size_t> rays{0};
  auto work = [&](size_t b, size_t e) {
    size_t cnt = 0;
    for (; b < e; b++) {
      V3 o = eye, d = dirOf(pix[b]); double w = 1, col = 0;
      for (int bounce = 0; bounce < 2; bounce++) {
        Ray ry = mk(o, d, 1e30); Hit h = trace1(ry); cnt++;
        if (h.prim == ~0u) { col += w * (.25 + .25 * d.y); break; }
        V3 P, n, dd; surface(ry, h, P, n, dd);
        V3 L = light - P, l = norm(L); double lam = dot(n, l), c = .08;
        if (lam > 0) { cnt++; if (!occl(mk(P, L, 1))) { V3 hv = norm(l - d); c += .7 * lam + .25 * std::pow(std::max(0.0, dot(n, hv)), 32); } }
        col += w * (bounce ? 1 : .75) * c; w *= .25; o = P; d = norm(d - (2 * dot(d, n)) * n);
      }
      uint8_t g = (uint8_t)(255 * std::pow(std::min(1.0, std::max(0.0, col)), 1 / 2.2) + .5);
      for (int k = 0; k < 3; k++) img[3 * (size_t)pix[b] + (size_t)k] = g;
    }
    rays += cnt;
  };
  if (server) {
    char name[96]; snprintf(name, sizeof name, "Embree %d.%d.%d %s%s%s%s", ver / 10000, ver / 100 % 100, ver % 100, quality, robust_ ? " robust" : "", compact ? " compact" : "", packet ? ", 16 rays" : "");
    return serve(name, packet, [&](int T) { return parallel(N, T, work); });
  }
  if (rayFile) return traceFile(rayFile, hitFile, any, threads, repeat, tag, base);

  std::vector<Ray> pr(N), sh, re; std::vector<Hit> ph(N); std::vector<float> tb(N);
  for (size_t i = 0; i < N; i++) pr[i] = mk(eye, dirOf(pix[i]), 1e30);
  auto say = [&](const char* st, const char* api, int T, size_t n, size_t hits, double sum, std::vector<double>& s) {
    printf("{\"stage\":\"%s\",\"tag\":\"%s\",\"mesh\":\"%s\",\"quality\":\"%s\",\"robust\":%d,\"api\":\"%s\",\"threads\":%d,\"rays\":%zu,\"hits\":%zu,\"sum\":%.6g,\"runs\":%zu,\"ms\":%.2f,\"Mrays_s\":%.2f,\"Mrays_s_min\":%.2f,\"Mrays_s_max\":%.2f}\n",
           st, tag, base, quality, (int)robust_, api, T, n, hits, sum, s.size(), median(s) * 1e3, (double)n / 1e6 / median(s), (double)n / 1e6 / *std::max_element(s.begin(), s.end()), (double)n / 1e6 / *std::min_element(s.begin(), s.end()));
  };
  auto closest = [&](const char* st, std::vector<Ray>& rays, std::vector<Hit>* keep) {
    size_t n = rays.size();
    for (int T : threads) {
      std::vector<double> s;
      for (int k = 0; k < repeat + 1; k++) { double d = parallel(n, T, [&](size_t b, size_t e) { for (; b < e; b++) (*keep)[b] = trace1(rays[b]); }); if (k) s.push_back(d); }
      size_t hits = 0; double sum = 0; for (auto& h : *keep) if (h.prim != ~0u) { hits++; sum += h.t; }
      say(st, "intersect1", T, n, hits, sum, s);
    }
  };
  closest("primary", pr, &ph); dumpSet(dumpRays, "primary", pr, ts(ph));
  for (int T : threads) for (int P : {8, 16}) {
    std::vector<double> s;
    for (int k = 0; k < repeat + 1; k++) { double d = parallel(N, T, [&](size_t b, size_t e) { for (; b < e; b += (size_t)P) { if (P == 8) tracePacket<8>(&pr[b], &tb[b]); else tracePacket<16>(&pr[b], &tb[b]); } }); if (k) s.push_back(d); }
    size_t hits = 0; double sum = 0; for (float t : tb) if (t >= 0) { hits++; sum += t; }
    say("primary", P == 8 ? "intersect8" : "intersect16", T, N, hits, sum, s);
  }
  if (dumpDepth) { std::vector<float> d(N); for (size_t i = 0; i < N; i++) d[pix[i]] = ph[i].prim == ~0u ? -1 : ph[i].t; dump(dumpDepth, d.data(), N * 4); }
  if (dumpPrim) { std::vector<uint32_t> d(N); for (size_t i = 0; i < N; i++) d[pix[i]] = ph[i].prim; dump(dumpPrim, d.data(), N * 4); }
  for (size_t i = 0; i < N; i++) if (ph[i].prim != ~0u) {
    V3 P, n, d; surface(pr[i], ph[i], P, n, d);
    sh.push_back(mk(P, light - P, 1)); re.push_back(mk(P, norm(d - (2 * dot(d, n)) * n), 1e30));
  }
  if (!sh.empty()) {
    for (int T : threads) {
      std::vector<double> s; std::vector<uint8_t> o(sh.size());
      for (int k = 0; k < repeat + 1; k++) { double d = parallel(sh.size(), T, [&](size_t b, size_t e) { for (; b < e; b++) o[b] = occl(sh[b]); }); if (k) s.push_back(d); }
      size_t hits = 0; for (auto v : o) hits += v;
      if (T == threads[0]) dumpSet(dumpRays, "shadow", sh, std::vector<float>(o.begin(), o.end()));
      say("shadow", "occluded1", T, sh.size(), hits, 0, s);
    }
    std::vector<Hit> rh(re.size()); closest("reflect", re, &rh); dumpSet(dumpRays, "reflect", re, ts(rh));
  }
  if (chords) {
    std::vector<Ray> cr(chords); std::vector<Hit> ch(chords); uint64_t s = 42; V3 c{(m.lo[0] + m.hi[0]) / 2, (m.lo[1] + m.hi[1]) / 2, (m.lo[2] + m.hi[2]) / 2};
    auto un = [&] { return (double)(sm(s) >> 11) * (1.0 / 9007199254740992.0); };
    auto pt = [&] { double z = 2 * un() - 1, p = 2 * M_PI * un(), q = std::sqrt(std::max(0.0, 1 - z * z)); return c + (D / 2) * V3{q * std::cos(p), q * std::sin(p), z}; };
    for (auto& x : cr) { V3 a = pt(), b = pt(); x = mk(a, norm(b - a), 1e30); }
    closest("chords", cr, &ch); dumpSet(dumpRays, "chords", cr, ts(ch));
    if (dumpChords) { std::vector<float> d(chords); for (size_t i = 0; i < chords; i++) d[i] = ch[i].prim == ~0u ? -1 : ch[i].t; dump(dumpChords, d.data(), chords * 4); }
  }
  if (frame) {
    for (int T : threads) {
      std::vector<double> s;
      for (int k = 0; k < repeat + 1; k++) { rays = 0; double d = parallel(N, T, work); if (k) s.push_back(d); }
      say("frame", "whitted", T, rays, 0, 0, s);
    }
    FILE* o = fopen(frame, "wb"); if (!o) { perror(frame); return 1; }
    fprintf(o, "P6\n%d %d\n255\n", W, H); fwrite(img.data(), 1, img.size(), o); fclose(o);
  }
  printf("{\"stage\":\"end\",\"tag\":\"%s\",\"mesh\":\"%s\",\"peak_rss_MiB\":%.1f,\"major_faults\":%ld}\n", tag, base, (double)statusKb("VmHWM:") / 1024., [] { rusage r; getrusage(RUSAGE_SELF, &r); return r.ru_majflt; }());
  return 0;
}
