/* Preloaded into a process that writes a store: its disk fails or loses power, its clock jumps.
 *
 * FAULTY_FILES   beginning of the paths of the files concerned; their folder is concerned too
 * FAULTY_LOG     every change of them is written to this file, in order: what the disk was told, for a replay
 * FAULTY_AFTER   so many changes succeed, all later ones fail ...
 * FAULTY_ERRNO   ... with this error
 * FAULTY_CLOCK   "seconds:shift seconds:shift ...": that long after the first look at the clock it is off by shift seconds
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define MOST_FILES 4096

static char *names[MOST_FILES]; /* path of an open file that is concerned, by descriptor */
static long changes;

/* What follows FAULTY_FILES in the path: "" of the store, "-journal"; "/" of the folder itself; NULL of all others. */
static const char *concerned(const char *path)
{
    const char *begin = getenv("FAULTY_FILES");
    if (!begin || !path)
        return NULL;
    size_t length = strlen(begin);
    if (strncmp(path, begin, length) == 0)
        return path + length;
    const char *slash = strrchr(begin, '/');
    if (slash && strlen(path) == (size_t)(slash - begin) && strncmp(path, begin, slash - begin) == 0)
        return "/";
    return NULL;
}

static void note(char what, const char *name, int64_t offset, const void *data, int64_t size)
{
    static int log = -1;
    const char *file = getenv("FAULTY_LOG");
    if (!file)
        return;
    if (log < 0)
        log = syscall(SYS_openat, AT_FDCWD, file, O_WRONLY | O_CREAT | O_APPEND, 0600);
    char head[512];
    int64_t held = data ? size : 0;
    int length = snprintf(head, sizeof head, "%c %s %lld %lld %lld\n", what, *name ? name : ".", (long long)offset,
                          (long long)size, (long long)held);
    syscall(SYS_write, log, head, length);
    if (held)
        syscall(SYS_write, log, data, held);
}

/* Whether the change fails; what does not is noted. */
static int fails(char what, const char *name, int64_t offset, const void *data, int64_t size)
{
    const char *after = getenv("FAULTY_AFTER"), *number = getenv("FAULTY_ERRNO");
    if (after && strcmp(name, ".told") && ++changes > atol(after)) { /* what a test writes down itself does not fail */
        errno = number ? atoi(number) : ENOSPC;
        return 1;
    }
    note(what, name, offset, data, size);
    return 0;
}

static const char *name_of(int descriptor)
{
    return descriptor >= 0 && descriptor < MOST_FILES ? names[descriptor] : NULL;
}

static int opened(int descriptor, const char *name)
{
    if (descriptor >= 0 && descriptor < MOST_FILES) {
        free(names[descriptor]);
        names[descriptor] = name ? strdup(name) : NULL;
    }
    return descriptor;
}

static int open_any(const char *path, int flags, mode_t mode)
{
    const char *name = concerned(path);
    int new = name && (flags & O_CREAT) && access(path, F_OK) != 0;
    if (new && fails('c', name, 0, NULL, 0))
        return -1;
    return opened(syscall(SYS_openat, AT_FDCWD, path, flags, mode), name);
}

#define OPEN(function)                                                                                                 \
    int function(const char *path, int flags, ...)                                                                     \
    {                                                                                                                  \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;                                        \
        va_end(rest);                                                                                                  \
        return open_any(path, flags, mode);                                                                            \
    }
OPEN(open)
OPEN(open64)

int close(int descriptor)
{
    opened(descriptor, NULL);
    return syscall(SYS_close, descriptor);
}

ssize_t write(int descriptor, const void *data, size_t size)
{
    const char *name = name_of(descriptor);
    if (name && fails('w', name, lseek(descriptor, 0, SEEK_CUR), data, size))
        return -1;
    return syscall(SYS_write, descriptor, data, size);
}

static ssize_t pwrite_any(int descriptor, const void *data, size_t size, off_t offset)
{
    const char *name = name_of(descriptor);
    if (name && fails('w', name, offset, data, size))
        return -1;
    return syscall(SYS_pwrite64, descriptor, data, size, offset);
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t offset)
{
    return pwrite_any(descriptor, data, size, offset);
}

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t offset)
{
    return pwrite_any(descriptor, data, size, offset);
}

static int truncate_any(int descriptor, off_t size)
{
    const char *name = name_of(descriptor);
    if (name && fails('t', name, 0, NULL, size))
        return -1;
    return syscall(SYS_ftruncate, descriptor, size);
}

int ftruncate(int descriptor, off_t size)
{
    return truncate_any(descriptor, size);
}

int ftruncate64(int descriptor, off64_t size)
{
    return truncate_any(descriptor, size);
}

static int sync_any(int descriptor)
{
    const char *name = name_of(descriptor);
    if (name && fails('s', name, 0, NULL, 0))
        return -1;
    return syscall(SYS_fsync, descriptor);
}

int fsync(int descriptor)
{
    return sync_any(descriptor);
}

int fdatasync(int descriptor)
{
    return sync_any(descriptor);
}

int unlink(const char *path)
{
    const char *name = concerned(path);
    if (name && fails('u', name, 0, NULL, 0))
        return -1;
    return syscall(SYS_unlinkat, AT_FDCWD, path, 0);
}

int clock_gettime(clockid_t id, struct timespec *now)
{
    static struct timespec first;
    int code = syscall(SYS_clock_gettime, id, now);
    const char *jumps = getenv("FAULTY_CLOCK");
    if (code || id != CLOCK_REALTIME || !jumps)
        return code;
    struct timespec since;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &since);
    if (!first.tv_sec)
        first = since;
    double after, shift, off = 0.0;
    int read;
    for (; sscanf(jumps, " %lf:%lf%n", &after, &shift, &read) == 2; jumps += read)
        if (since.tv_sec - first.tv_sec >= after)
            off = shift;
    now->tv_sec += (time_t)off;
    return code;
}
