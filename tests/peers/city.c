/* city: write a town of any size as Wavefront OBJ: what architecture does to a tracer, in a mesh of millions of triangles.
 *
 *   city -n BLOCKS -o out.obj [-s SEED] [-w WINDOWS]
 *
 * BLOCKS x BLOCKS blocks of 100 m stand on a ground of two triangles. Along and across run streets and kerbs, each a strip of two
 * triangles as long as the town; over the streets hang cables, prisms of 4 mm. A block has four houses: walls and a flat
 * roof of two triangles each, before them up to WINDOWS windows a house (a pane in a frame of four bars), on the roof
 * some boxes and a mast. The y axis points up. The same options give the same bytes; a block has some 9 thousand triangles at
 * WINDOWS = 90, the default.
 *
 * Build: cc -O2 -o city city.c
 */
#include <stdio.h>
#include <stdlib.h>
#include <stdint.h>
#include <unistd.h>

static FILE *out;
static long vertices, triangles;
static uint64_t state;

/* A number from low to high. */
static double pick(double low, double high) {
  state = state * 6364136223846793005u + 1442695040888963407u;
  return low + (high - low) * (double)(state >> 40) / 16777216.0;
}

/* Four corners in a ring, as two triangles. */
static void quad(const double p[4][3]) {
  for (int i = 0; i < 4; i++) fprintf(out, "v %.4f %.4f %.4f\n", p[i][0], p[i][1], p[i][2]);
  fprintf(out, "f %ld %ld %ld\nf %ld %ld %ld\n", vertices + 1, vertices + 2, vertices + 3, vertices + 1, vertices + 3, vertices + 4);
  vertices += 4, triangles += 2;
}

/* A rectangle at height y. */
static void flat(double x0, double z0, double x1, double z1, double y) {
  quad((double[4][3]){{x0, y, z0}, {x0, y, z1}, {x1, y, z1}, {x1, y, z0}});
}

/* An upright rectangle from (x0, z0) to (x1, z1). */
static void upright(double x0, double z0, double x1, double z1, double y0, double y1) {
  quad((double[4][3]){{x0, y0, z0}, {x1, y0, z1}, {x1, y1, z1}, {x0, y1, z0}});
}

/* A box without its bottom. */
static void box(double x0, double y0, double z0, double x1, double y1, double z1) {
  upright(x0, z0, x1, z0, y0, y1), upright(x1, z0, x1, z1, y0, y1);
  upright(x1, z1, x0, z1, y0, y1), upright(x0, z1, x0, z0, y0, y1);
  flat(x0, z0, x1, z1, y1);
}

/* A prism of 4 mm between two points. */
static void cable(const double a[3], const double b[3]) {
  static const double d[3][3] = {{0, 0.004, 0}, {0.003, -0.002, 0.003}, {-0.003, -0.002, -0.003}};
  for (int i = 0; i < 3; i++) {
    double p[4][3];
    for (int k = 0; k < 3; k++) {
      p[0][k] = a[k] + d[i][k], p[1][k] = b[k] + d[i][k];
      p[2][k] = b[k] + d[(i + 1) % 3][k], p[3][k] = a[k] + d[(i + 1) % 3][k];
    }
    quad(p);
  }
}

/* A window 1.2 m wide, 1.5 m high, whose lower left corner is (x, y, z), on a wall along x (or z) that looks to `side`. */
static void window(double x, double y, double z, int along_z, double side) {
  const double bars[4][4] = {{0, 0, 1.2, 0.08}, {0, 1.42, 1.2, 1.5}, {0, 0.08, 0.08, 1.42}, {1.12, 0.08, 1.2, 1.42}};
  double d = 0.06 * side, e = 0.02 * side;
  for (int i = 0; i < 4; i++) {
    const double *b = bars[i];
    if (along_z) box(side > 0 ? x : x + d, y + b[1], z + b[0], side > 0 ? x + d : x, y + b[3], z + b[2]);
    else box(x + b[0], y + b[1], side > 0 ? z : z + d, x + b[2], y + b[3], side > 0 ? z + d : z);
  }
  if (along_z) upright(x + e, z + 0.08, x + e, z + 1.12, y + 0.08, y + 1.42);
  else upright(x + 0.08, z + e, x + 1.12, z + e, y + 0.08, y + 1.42);
}

/* A house; the height of its roof. */
static double house(double x0, double z0, double x1, double z1, int windows) {
  double height = pick(0, 1) < 0.1 ? pick(40, 90) : pick(9, 30);
  box(x0, 0, z0, x1, height, z1);
  int floors = (int)((height - 1) / 3), left = windows;
  for (int floor = 0; floor < floors; floor++)
    for (int wall = 0; wall < 4; wall++) {
      int along_z = wall & 1;
      double from = along_z ? z0 : x0, to = along_z ? z1 : x1;
      for (double at = from + 1.5; at + 1.5 < to && left > 0; at += 3.1, left--) {
        double y = 3 * floor + 1;
        if (along_z) window(wall == 1 ? x1 : x0, y, at, 1, wall == 1 ? 1 : -1);
        else window(at, y, wall == 0 ? z0 : z1, 0, wall == 0 ? -1 : 1);
      }
    }
  for (int i = 0; i < 12; i++) {
    double x = pick(x0, x1 - 2), z = pick(z0, z1 - 2);
    box(x, height, z, x + pick(0.3, 2), height + pick(0.3, 1.5), z + pick(0.3, 2));
  }
  double mast[2][3] = {{0.5 * (x0 + x1), height, 0.5 * (z0 + z1)}, {0.5 * (x0 + x1), height + pick(3, 12), 0.5 * (z0 + z1)}};
  cable(mast[0], mast[1]);
  return height;
}

int main(int argc, char **argv) {
  int n = 16, windows = 90;
  const char *name = NULL;
  for (int c; (c = getopt(argc, argv, "n:o:s:w:")) != -1;) {
    if (c == 'n') n = atoi(optarg);
    else if (c == 'o') name = optarg;
    else if (c == 's') state = strtoull(optarg, NULL, 10);
    else if (c == 'w') windows = atoi(optarg);
    else return 2;
  }
  if (!name || n < 1) return fprintf(stderr, "usage: city -n BLOCKS -o out.obj [-s SEED] [-w WINDOWS]\n"), 2;
  if (!(out = fopen(name, "w"))) return perror(name), 1;
  double size = 100.0 * n;
  flat(-50, -50, size + 50, size + 50, 0);
  for (int i = 0; i <= n; i++) {
    double x = 100.0 * i;
    flat(x - 6, 0, x + 6, size, 0.02), flat(0, x - 6, size, x + 6, 0.03);
    for (int side = -1; side <= 1; side += 2) {
      double kerb = x + 6.2 * side;
      upright(kerb, 0, kerb, size, 0, 0.15), upright(0, kerb, size, kerb, 0, 0.15);
    }
  }
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      double roofs[4];
      for (int k = 0; k < 4; k++) {
        double x = 100.0 * i + 10 + 41 * (k & 1), z = 100.0 * j + 10 + 41 * (k >> 1);
        roofs[k] = house(x + pick(0, 6), z + pick(0, 6), x + 39 - pick(0, 6), z + 39 - pick(0, 6), windows);
      }
      for (int k = 0; k < 8; k++) {
        double at = 100.0 * j + pick(12, 88), y = pick(4, roofs[k & 3]);
        double a[3] = {100.0 * i + 12, y, at}, b[3] = {100.0 * i - 12, y - 0.5, at + pick(-8, 8)};
        if (i > 0) cable(a, b);
      }
    }
  if (fclose(out)) return perror(name), 1;
  fprintf(stderr, "%ld vertices, %ld triangles\n", vertices, triangles);
  return 0;
}
