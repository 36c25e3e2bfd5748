/* Makes one call of a kind fail, for tests of what a program does when the machine fails it. Loaded with LD_PRELOAD.
 *
 *   OCTRACE_FAULT=KIND:NUMBER:WHAT    the NUMBERth call (from 1) of KIND (read, write, sync, rename, open) fails with the error number
 *                                     WHAT, and so do all after it; or the process is killed there, before the call, if WHAT is `kill`
 *   OCTRACE_FAULT_COUNTS=FILE         writes how many calls of each kind there were
 *
 * Only calls on ordinary files count, and `open` only those that may create one. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { READ, WRITE, SYNC, RENAME, OPEN, KINDS };
static const char *const names[KINDS] = {"read", "write", "sync", "rename", "open"};
static atomic_long counts[KINDS];
static int kind = -1, what;
static long number;

__attribute__((constructor)) static void begin(void) {
    const char *text = getenv("OCTRACE_FAULT");
    char name[16], tail[16];
    if (!text || sscanf(text, "%15[a-z]:%ld:%15s", name, &number, tail) != 3) return;
    for (int k = 0; k < KINDS; k++)
        if (!strcmp(name, names[k])) kind = k;
    what = strcmp(tail, "kill") ? atoi(tail) : -1;
}

__attribute__((destructor)) static void end(void) {
    const char *path = getenv("OCTRACE_FAULT_COUNTS");
    FILE *file = path ? fopen(path, "w") : NULL;
    if (!file) return;
    for (int k = 0; k < KINDS; k++) fprintf(file, "%s %ld\n", names[k], (long)counts[k]);
    fclose(file);
}

static int fails(int k) {
    long now = ++counts[k];
    if (k != kind || now < number) return 0;
    if (what < 0) raise(SIGKILL);
    errno = what;
    return 1;
}

static int ordinary(int fd) {
    struct stat s;
    return fstat(fd, &s) == 0 && S_ISREG(s.st_mode);
}

#define REAL(result, name, ...) static result (*real)(__VA_ARGS__); if (!real) *(void **)&real = dlsym(RTLD_NEXT, name)

ssize_t read(int fd, void *to, size_t n) {
    REAL(ssize_t, "read", int, void *, size_t);
    return ordinary(fd) && fails(READ) ? -1 : real(fd, to, n);
}
ssize_t pread64(int fd, void *to, size_t n, off64_t at) {
    REAL(ssize_t, "pread64", int, void *, size_t, off64_t);
    return ordinary(fd) && fails(READ) ? -1 : real(fd, to, n, at);
}
ssize_t write(int fd, const void *from, size_t n) {
    REAL(ssize_t, "write", int, const void *, size_t);
    return ordinary(fd) && fails(WRITE) ? -1 : real(fd, from, n);
}
ssize_t writev(int fd, const struct iovec *from, int n) {
    REAL(ssize_t, "writev", int, const struct iovec *, int);
    return ordinary(fd) && fails(WRITE) ? -1 : real(fd, from, n);
}
ssize_t pwrite64(int fd, const void *from, size_t n, off64_t at) {
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    return ordinary(fd) && fails(WRITE) ? -1 : real(fd, from, n, at);
}
int fsync(int fd) {
    REAL(int, "fsync", int);
    return ordinary(fd) && fails(SYNC) ? -1 : real(fd);
}
int fdatasync(int fd) {
    REAL(int, "fdatasync", int);
    return ordinary(fd) && fails(SYNC) ? -1 : real(fd);
}
int rename(const char *from, const char *to) {
    REAL(int, "rename", const char *, const char *);
    return fails(RENAME) ? -1 : real(from, to);
}
int open64(const char *path, int flags, ...) {
    REAL(int, "open64", const char *, int, ...);
    va_list list;
    va_start(list, flags);
    int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(list, int) : 0;
    va_end(list);
    return flags & O_CREAT && fails(OPEN) ? -1 : real(path, flags, mode);
}
