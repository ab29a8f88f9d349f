/* Preloaded into a process: every write, truncation and sync of files whose path contains SYNCLOG_MATCH goes, in its
   order, into the file SYNCLOG too. A record is: kind (W, T, S), number of the file, offset, size, bytes of a W. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int log_fd = -1;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static ssize_t real_write(int fd, const void *data, size_t size) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = dlsym(RTLD_NEXT, "write");
    return real(fd, data, size);
}

/* 0: none of ours; else 1 + its place among the names seen so far. */
static int file_of(int fd) {
    static char names[16][512];
    static int count;
    char link[64], path[512];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    const char *match = getenv("SYNCLOG_MATCH");
    if (size <= 0 || !match) return 0;
    path[size] = 0;
    if (!strstr(path, match) || strstr(path, "-shm")) return 0;
    for (int n = 0; n < count; n++)
        if (!strcmp(names[n], path)) return n + 1;
    if (count == 16) abort();
    strcpy(names[count], path);
    uint64_t head[3] = {(uint64_t)'N' << 32 | (uint64_t)count, 0, (uint64_t)size};
    real_write(log_fd, head, sizeof head);
    real_write(log_fd, path, size);
    return ++count;
}

static void record(char kind, int fd, uint64_t offset, uint64_t size, const void *data) {
    if (log_fd == -1) {
        const char *path = getenv("SYNCLOG");
        log_fd = path ? open(path, O_WRONLY | O_CREAT | O_APPEND, 0600) : -2;
    }
    if (log_fd < 0) return;
    pthread_mutex_lock(&lock);
    int file = file_of(fd);
    if (file) {
        uint64_t head[3] = {(uint64_t)kind << 32 | (uint64_t)(file - 1), offset, size};
        real_write(log_fd, head, sizeof head);
        if (data) real_write(log_fd, data, size);
    }
    pthread_mutex_unlock(&lock);
}

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = dlsym(RTLD_NEXT, name)

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset) {
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    ssize_t done = real(fd, data, size, offset);
    if (done > 0) record('W', fd, offset, done, data);
    return done;
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) { return pwrite64(fd, data, size, offset); }

ssize_t write(int fd, const void *data, size_t size) {
    off_t offset = fd > 2 ? lseek(fd, 0, SEEK_CUR) : -1;
    ssize_t done = real_write(fd, data, size);
    if (done > 0 && offset >= 0) record('W', fd, offset, done, data);
    return done;
}

int ftruncate64(int fd, off64_t size) {
    REAL(int, "ftruncate64", int, off64_t);
    int done = real(fd, size);
    if (!done) record('T', fd, 0, size, NULL);
    return done;
}

int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }

int fsync(int fd) {
    REAL(int, "fsync", int);
    int done = real(fd);
    if (!done) record('S', fd, 0, 0, NULL);
    return done;
}

int fdatasync(int fd) {
    REAL(int, "fdatasync", int);
    int done = real(fd);
    if (!done) record('S', fd, 0, 0, NULL);
    return done;
}
