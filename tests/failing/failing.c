/* Calls of the C library that fail when they are told to: preloaded into a process, it counts the calls of each kind
 * and lets the n-th of one kind fail, once or from then on.
 *
 * A page of memory that all processes of a case share, the file named by FAILING_PAGE, says what is to fail and takes
 * the counts.  A process plays no part until it calls `failing_role`: start-up and imports are then behind it. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <poll.h>
#include <stdio.h>
#include <unistd.h>

enum kind { OPEN, WRITE, SEND, READ, SYNC, RENAME, SOCKET, FORK, ALLOC, WAIT, KINDS };
enum { ROLES = 3 };

struct page {                       /* see failing.py, which reads and writes it */
    _Atomic long counts[ROLES][KINDS];
    _Atomic long fired;
    long role, kind, nth, error, lasting, least;
    char name[64];                  /* of the call that failed first */
    char stack[4096];               /* not used here: of the Python code that made it */
};

static struct page *page;
static volatile int role;           /* of this process; 0 plays no part */

__attribute__((constructor)) static void attach(void)
{
    const char *path = getenv("FAILING_PAGE");
    int file = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *mapped = mmap(NULL, sizeof(struct page), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (mapped != MAP_FAILED) page = mapped;
}

void failing_role(int chosen) { role = chosen; }

/* Count a call; return the error with which it is to fail, 0 for none, -1 for one that does half of its work. */
static int due(enum kind kind, const char *name)
{
    if (!role || !page) return 0;
    long n = atomic_fetch_add(&page->counts[role][kind], 1) + 1;
    if (page->role != role || page->kind != kind || !page->nth) return 0;
    if (n != page->nth && !(page->lasting && n > page->nth)) return 0;
    if (!atomic_fetch_add(&page->fired, 1)) {
        strncpy(page->name, name, sizeof page->name - 1);
        void (*dump)(int, void *) = dlsym(RTLD_DEFAULT, "_Py_DumpTraceback");
        void *(*state)(void) = dlsym(RTLD_DEFAULT, "PyGILState_GetThisThreadState");
        const char *trace = getenv("FAILING_TRACE");
        if (trace && dump && state) {
            int before = role;
            role = 0;
            int file = open(trace, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
            if (file >= 0) { dump(file, state()); close(file); }
            role = before;
        }
    }
    return (int)page->error;
}

#define REAL(type, name, ...) static type (*real)(__VA_ARGS__); if (!real) real = dlsym(RTLD_NEXT, #name)
#define FAIL(kind, name) do { int error_ = due(kind, #name); if (error_ > 0) { errno = error_; return -1; } } while (0)
#define CALL(kind, name, parameters, ...) \
    int name parameters { int (*real) parameters = dlsym(RTLD_NEXT, #name); FAIL(kind, name); return real(__VA_ARGS__); }

/* --- descriptors */

#define OPENS(name) int name(const char *path, int flags, ...) { \
    va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
    REAL(int, name, const char *, int, ...); FAIL(OPEN, name); return real(path, flags, mode); }
#define OPENS_AT(name) int name(int folder, const char *path, int flags, ...) { \
    va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
    REAL(int, name, int, const char *, int, ...); FAIL(OPEN, name); return real(folder, path, flags, mode); }
OPENS(open)
OPENS(open64)
OPENS_AT(openat)
OPENS_AT(openat64)
CALL(OPEN, pipe, (int ends[2]), ends)
CALL(OPEN, pipe2, (int ends[2], int flags), ends, flags)
CALL(OPEN, epoll_create1, (int flags), flags)

CALL(SOCKET, socket, (int domain, int type, int protocol), domain, type, protocol)
CALL(SOCKET, socketpair, (int domain, int type, int protocol, int ends[2]), domain, type, protocol, ends)
CALL(SOCKET, bind, (int file, const struct sockaddr *to, socklen_t size), file, to, size)
CALL(SOCKET, listen, (int file, int backlog), file, backlog)
CALL(SOCKET, accept, (int file, struct sockaddr *from, socklen_t *size), file, from, size)
CALL(SOCKET, accept4, (int file, struct sockaddr *from, socklen_t *size, int flags), file, from, size, flags)
CALL(SOCKET, connect, (int file, const struct sockaddr *to, socklen_t size), file, to, size)

/* --- bytes: into files WRITE, into pipes and sockets SEND */

static enum kind written(int file)
{
    struct stat status;
    return fstat(file, &status) == 0 && S_ISREG(status.st_mode) ? WRITE : SEND;
}

#define SHORTENED(kind, name, size) do { \
    int error_ = due(kind, #name); \
    if (error_ > 0) { errno = error_; return -1; } \
    if (error_ < 0 && size > 1) size /= 2; } while (0)
#define SPARED (file == 2 && page && page->lasting)  /* what ended it can still be said */

ssize_t write(int file, const void *data, size_t size)
{
    REAL(ssize_t, write, int, const void *, size_t);
    if (role && !SPARED) SHORTENED(written(file), write, size);
    return real(file, data, size);
}

ssize_t pwrite64(int file, const void *data, size_t size, off64_t at)
{
    REAL(ssize_t, pwrite64, int, const void *, size_t, off64_t);
    SHORTENED(WRITE, pwrite64, size);
    return real(file, data, size, at);
}

ssize_t writev(int file, const struct iovec *parts, int count)
{
    REAL(ssize_t, writev, int, const struct iovec *, int);
    if (role) FAIL(written(file), writev);
    return real(file, parts, count);
}

ssize_t send(int file, const void *data, size_t size, int flags)
{
    REAL(ssize_t, send, int, const void *, size_t, int);
    SHORTENED(SEND, send, size);
    return real(file, data, size, flags);
}

ssize_t sendto(int file, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
    REAL(ssize_t, sendto, int, const void *, size_t, int, const struct sockaddr *, socklen_t);
    SHORTENED(SEND, sendto, size);
    return real(file, data, size, flags, to, length);
}

ssize_t sendmsg(int file, const struct msghdr *message, int flags)
{
    REAL(ssize_t, sendmsg, int, const struct msghdr *, int);
    FAIL(SEND, sendmsg);
    return real(file, message, flags);
}

ssize_t read(int file, void *data, size_t size)
{
    REAL(ssize_t, read, int, void *, size_t);
    SHORTENED(READ, read, size);
    return real(file, data, size);
}

ssize_t recv(int file, void *data, size_t size, int flags)
{
    REAL(ssize_t, recv, int, void *, size_t, int);
    SHORTENED(READ, recv, size);
    return real(file, data, size, flags);
}

/* --- names and the disk */

CALL(SYNC, fsync, (int file), file)
CALL(SYNC, fdatasync, (int file), file)
CALL(RENAME, rename, (const char *from, const char *to), from, to)
CALL(RENAME, renameat, (int folder, const char *from, int other, const char *to), folder, from, other, to)
CALL(RENAME, link, (const char *from, const char *to), from, to)
CALL(RENAME, linkat, (int folder, const char *from, int other, const char *to, int flags), folder, from, other, to, flags)
CALL(RENAME, unlink, (const char *path), path)
CALL(RENAME, unlinkat, (int folder, const char *path, int flags), folder, path, flags)
CALL(RENAME, mkdir, (const char *path, mode_t mode), path, mode)

/* --- processes and threads */

pid_t fork(void)
{
    REAL(pid_t, fork, void);
    FAIL(FORK, fork);
    return real();
}

pid_t vfork(void)  /* a vfork cannot be wrapped, for its caller's frame is shared: a fork does the same */
{
    REAL(pid_t, fork, void);
    FAIL(FORK, vfork);
    return real();
}

int pthread_create(pthread_t *thread, const pthread_attr_t *how, void *(*run)(void *), void *with)
{
    REAL(int, pthread_create, pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
    int error = due(FORK, "pthread_create");
    return error > 0 ? error : real(thread, how, run, with);
}

/* --- waiting */

CALL(WAIT, select, (int count, fd_set *r, fd_set *w, fd_set *x, struct timeval *timeout), count, r, w, x, timeout)
CALL(WAIT, poll, (struct pollfd *files, nfds_t count, int timeout), files, count, timeout)
CALL(WAIT, epoll_wait, (int file, struct epoll_event *events, int most, int timeout), file, events, most, timeout)

/* --- memory: glibc's own names, for dlsym itself allocates */

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);

static int refused(size_t size, const char *name)
{
    return role && page && (long)size >= page->least && due(ALLOC, name) > 0 && (errno = ENOMEM);
}

void *malloc(size_t size) { return refused(size, "malloc") ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return refused(count * size, "calloc") ? NULL : __libc_calloc(count, size); }
void *realloc(void *block, size_t size) { return refused(size, "realloc") ? NULL : __libc_realloc(block, size); }
void *aligned_alloc(size_t to, size_t size) { return refused(size, "aligned_alloc") ? NULL : __libc_memalign(to, size); }

int posix_memalign(void **block, size_t to, size_t size)
{
    if (refused(size, "posix_memalign")) return ENOMEM;
    return (*block = __libc_memalign(to, size)) ? 0 : ENOMEM;
}

#define MAPS(name) void *name(void *at, size_t size, int allowed, int flags, int file, off_t offset) { \
    REAL(void *, name, void *, size_t, int, int, int, off_t); \
    if (file < 0 && refused(size, #name)) return MAP_FAILED; \
    return real(at, size, allowed, flags, file, offset); }
MAPS(mmap)
MAPS(mmap64)
