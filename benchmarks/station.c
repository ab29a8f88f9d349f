/* Simulated Modbus RTU stations on ptys for measuring masters; shares no code with drivebus.
 *
 *   station LINES STATIONS BAUD BITS DELAY_US DEAD LATE_PERMILLE LATE_US MISSING_PERMILLE DAMAGED_PERMILLE SEED
 *           [FLAT RECORD]
 *
 * Prints one pty path per line, then "ready". BAUD 0: unpaced, answers at once in one write. Otherwise a reply begins
 * when the request's last bit would have arrived (BITS a character) plus DELAY_US, and its bytes are delivered one by
 * one, each when its last bit would have arrived. DEAD: that address never answers. LATE_PERMILLE of the replies come
 * LATE_US late. Register r of station a reads (a << 8 | (r & 255)), so a reply accepted for another request is detected.
 * MISSING_PERMILLE are never sent, DAMAGED_PERMILLE have one inverted bit. SEED chooses the faulty replies; where it is
 * 0, a late reply delays every reply after it (as a serial server does), else only itself (as a slow drive does): where
 * it meets a request or a reply on the wire, the request is lost or each byte of the reply is damaged. Then the top bit
 * of each of its registers is set, so that a late reply that is accepted for the same register is detected.
 * FLAT: registers from this one on read 1 (0: none). RECORD: a file that gets a line for each complete request: its bus,
 * the nanosecond (CLOCK_MONOTONIC) at which its first byte arrived, that of its reply's last byte (0: none), its bytes.
 * Ends at end of file on stdin and prints counts as JSON; "gap" is the silence before a request, in characters,
 * measured here: from the last bit of the last reply to the moment the request is seen.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/prctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define QUEUE 4096
struct event { int64_t at; uint8_t byte; };
struct line {
    int fd, slave, have, started;
    uint8_t in[512];
    struct event out[QUEUE];
    int head, tail;
    int64_t first_byte_at, arrived, quiet_since, first;
    long requests, replies, late, missing, damaged, collisions, bad, shortgaps;
    struct overdue { int64_t at; int len; uint8_t bytes[256]; } overdue[64]; /* late replies that delay no other */
    double smallest, gaps;
    int64_t useful;
};

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000LL + t.tv_nsec;
}

static uint16_t crc16(const uint8_t *p, int n) {
    uint16_t c = 0xFFFF;
    while (n--) {
        c ^= *p++;
        for (int i = 0; i < 8; i++) c = c & 1 ? (c >> 1) ^ 0xA001 : c >> 1;
    }
    return c;
}

static uint32_t seed = 1;
static uint32_t chance(void) { seed = seed * 1664525u + 1013904223u; return seed >> 8; }

static int64_t character; /* ns, 0 = unpaced */
static int64_t delay, late_ns;
static int dead, late_permille, missing_permille, damaged_permille, flat, apart;
static FILE *record;

static int64_t transmit(struct line *l, int64_t at, const uint8_t *out, int len) {
    if (l->head != l->tail && l->out[(l->tail + QUEUE - 1) % QUEUE].at > at) at = l->out[(l->tail + QUEUE - 1) % QUEUE].at;
    for (int i = 0; i < len; i++) {
        at += character;
        l->out[l->tail] = (struct event){at, out[i]};
        l->tail = (l->tail + 1) % QUEUE;
    }
    return at;
}

/* A late reply begins: the frames that it meets on the wire are destroyed, and it is too. */
static void collide_or_transmit(struct line *l, struct overdue *o) {
    int busy = l->head != l->tail, requesting = o->at < l->arrived;
    if (busy && !requesting)
        for (int i = l->head; i != l->tail; i = (i + 1) % QUEUE) l->out[i].byte ^= 0x55;
    if (busy && requesting) l->head = l->tail;
    if (!busy || requesting) {
        for (int i = 0; requesting && i < o->len; i++) o->bytes[i] ^= 0x55;
        transmit(l, o->at, o->bytes, o->len);
    }
    l->collisions += busy || requesting;
    o->len = 0;
}

static int64_t reply(struct line *l, int64_t arrived) {
    uint8_t *q = l->in, out[256];
    int n = q[4] << 8 | q[5], len;
    if (q[1] == 3 && n >= 1 && n <= 125) {
        int reg = q[2] << 8 | q[3];
        out[0] = q[0]; out[1] = 3; out[2] = (uint8_t)(2 * n);
        for (int i = 0; i < n; i++) {
            int here = flat && reg + i >= flat;
            out[3 + 2 * i] = here ? 0 : q[0];
            out[4 + 2 * i] = here ? 1 : (uint8_t)(reg + i);
        }
        len = 3 + 2 * n;
    } else {
        memcpy(out, q, 6);
        len = 6;
    }
    int drawn = (int)(chance() % 1000);
    int is_late = drawn < late_permille;
    int is_missing = !is_late && drawn < late_permille + missing_permille;
    int is_damaged = !is_late && !is_missing && drawn < late_permille + missing_permille + damaged_permille;
    if (is_missing) { l->missing++; return 0; }
    if (is_late && apart && q[1] == 3)
        for (int i = 3; i < len; i += 2) out[i] |= 0x80;
    uint16_t c = crc16(out, len);
    out[len++] = c & 255; out[len++] = c >> 8;
    if (is_damaged) { l->damaged++; uint32_t bit = chance() % (uint32_t)(8 * len); out[bit / 8] ^= (uint8_t)(1 << bit % 8); }
    if (!character && !is_late) {
        if (write(l->fd, out, len) == len) l->replies++;
        l->quiet_since = now_ns();
        return l->quiet_since;
    }
    int64_t at = arrived + delay + (is_late ? late_ns : 0);
    l->late += is_late;
    if (!is_late && !is_damaged) l->useful += character * (8 + len) + delay + character * 7 / 2;
    if (is_late && apart) {
        for (int i = 0; i < 64; i++)
            if (!l->overdue[i].len) {
                l->overdue[i].at = at; l->overdue[i].len = len;
                memcpy(l->overdue[i].bytes, out, (size_t)len);
                break;
            }
        return at + len * character;
    }
    at = transmit(l, at, out, len);
    l->replies++;
    return at;
}

static void note(int number, const struct line *l, int64_t end) {
    fprintf(record, "%d %lld %lld ", number, (long long)l->first_byte_at, (long long)end);
    for (int i = 0; i < 8; i++) fprintf(record, "%02x", l->in[i]);
    fputc('\n', record);
}

static void read_line(int number, struct line *l, int64_t t) {
    ssize_t n = read(l->fd, l->in + l->have, sizeof l->in - l->have);
    if (n <= 0) return;
    if (l->have == 0) {
        l->first_byte_at = t;
        if (l->started && character) {
            double gap = (double)(t - l->quiet_since) / (double)character;
            if (gap < l->smallest) l->smallest = gap;
            if (gap < 3.5) l->shortgaps++;
            l->gaps += gap;
        }
        if (!l->started) { l->started = 1; l->first = t; }
    }
    l->have += (int)n;
    while (l->have >= 8) {
        int64_t arrived = l->first_byte_at + 8 * character;
        l->arrived = arrived;
        if (crc16(l->in, 6) == (l->in[6] | l->in[7] << 8)) {
            l->requests++;
            l->quiet_since = arrived;
            int64_t end = l->in[0] != dead && l->in[0] != 0 ? reply(l, arrived) : 0;
            if (record) note(number, l, end);
        } else {
            l->bad++;
        }
        memmove(l->in, l->in + 8, (size_t)(l->have -= 8));
    }
}

int main(int argc, char **argv) {
    if (argc < 12) return 2;
    int lines = atoi(argv[1]);
    int baud = atoi(argv[3]);
    character = baud ? 1000000000LL * atoi(argv[4]) / baud : 0;
    delay = 1000LL * atoi(argv[5]);
    dead = atoi(argv[6]);
    late_permille = atoi(argv[7]);
    late_ns = 1000LL * atoi(argv[8]);
    missing_permille = atoi(argv[9]);
    damaged_permille = atoi(argv[10]);
    apart = atoi(argv[11]) != 0;
    if (apart) seed = (uint32_t)atoi(argv[11]);
    flat = argc > 12 ? atoi(argv[12]) : 0;
    record = argc > 13 ? fopen(argv[13], "w") : NULL;
    struct line *all = calloc((size_t)lines, sizeof *all);
    prctl(PR_SET_TIMERSLACK, 1UL); /* wake at the microsecond, not 50 us later */
    int ep = epoll_create1(0);
    for (int i = 0; i < lines; i++) {
        struct line *l = &all[i];
        struct termios raw;
        l->fd = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
        grantpt(l->fd); unlockpt(l->fd);
        l->slave = open(ptsname(l->fd), O_RDWR | O_NOCTTY);
        tcgetattr(l->slave, &raw); cfmakeraw(&raw); tcsetattr(l->slave, TCSANOW, &raw);
        l->smallest = 1e9;
        struct epoll_event e = {.events = EPOLLIN, .data.ptr = l};
        epoll_ctl(ep, EPOLL_CTL_ADD, l->fd, &e);
        printf("%s\n", ptsname(l->fd));
    }
    struct epoll_event in = {.events = EPOLLIN, .data.ptr = NULL};
    epoll_ctl(ep, EPOLL_CTL_ADD, 0, &in);
    printf("ready\n");
    fflush(stdout);
    for (int stop = 0; !stop;) {
        struct epoll_event e[64];
        int64_t next = now_ns() + 100000000LL;
        for (int i = 0; i < lines; i++)
            if (all[i].head != all[i].tail && all[i].out[all[i].head].at < next) next = all[i].out[all[i].head].at;
        for (int i = 0; apart && i < lines; i++)
            for (int k = 0; k < 64; k++)
                if (all[i].overdue[k].len && all[i].overdue[k].at < next) next = all[i].overdue[k].at;
        int64_t wait = next - now_ns();
        if (wait < 0) wait = 0;
        struct timespec w = {wait / 1000000000LL, wait % 1000000000LL};
        int n = epoll_pwait2(ep, e, 64, &w, NULL);
        int64_t t = now_ns();
        for (int i = 0; i < n; i++) {
            if (e[i].data.ptr) {
                struct line *l = e[i].data.ptr;
                read_line((int)(l - all), l, t);
                continue;
            }
            char c[16];
            if (read(0, c, sizeof c) <= 0) stop = 1;
        }
        if (!character && !late_permille) continue;
        for (int i = 0; i < lines; i++) {
            struct line *l = &all[i];
            for (int k = 0; apart && k < 64; k++)
                if (l->overdue[k].len && l->overdue[k].at <= t) collide_or_transmit(l, &l->overdue[k]);
            while (l->head != l->tail && l->out[l->head].at <= t) {
                if (write(l->fd, &l->out[l->head].byte, 1) != 1 && errno == EAGAIN) break;
                l->quiet_since = character ? l->out[l->head].at : t;
                l->head = (l->head + 1) % QUEUE;
            }
        }
    }
    if (record) fclose(record);
    long requests = 0, replies = 0, late = 0, missing = 0, damaged = 0, collisions = 0, bad = 0, shortgaps = 0;
    double smallest = 1e9, gaps = 0, use = 0;
    for (int i = 0; i < lines; i++) {
        struct line *l = &all[i];
        requests += l->requests; replies += l->replies; late += l->late; missing += l->missing; damaged += l->damaged;
        collisions += l->collisions; bad += l->bad; shortgaps += l->shortgaps;
        if (l->smallest < smallest) smallest = l->smallest;
        gaps += l->gaps;
        if (l->started) use += (double)l->useful / (double)(l->quiet_since - l->first + 1);
    }
    printf("{\"requests\": %ld, \"replies\": %ld, \"late\": %ld, \"missing\": %ld, \"damaged\": %ld, \"collisions\": %ld, \"bad\": %ld, \"short_gaps\": %ld, "
           "\"smallest_gap\": %.3f, \"mean_gap\": %.3f, \"utilisation\": %.4f}\n",
           requests, replies, late, missing, damaged, collisions, bad, shortgaps, smallest, requests ? gaps / (double)requests : 0.0, use / lines);
    return 0;
}
