/* libmodbus' RTU client over the same round. cc -O2 libmodbus_client.c $(pkg-config --cflags --libs libmodbus) */
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <time.h>

static double wall(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + t.tv_nsec / 1e9; }
static double cpu(void) {
    struct rusage r;
    getrusage(RUSAGE_SELF, &r);
    return r.ru_utime.tv_sec + r.ru_utime.tv_usec / 1e6 + r.ru_stime.tv_sec + r.ru_stime.tv_usec / 1e6;
}

int main(int argc, char **argv) {
    if (argc < 5) return 2;
    int stations = atoi(argv[2]), baud = atoi(argv[4]);
    double seconds = atof(argv[3]);
    modbus_t *m = modbus_new_rtu(argv[1], baud, 'N', 8, 1);
    if (!m || modbus_connect(m)) return 1;
    long done = 0, failed = 0, wrong = 0;
    double c = cpu(), w = wall();
    while (wall() - w < seconds) {
        int station = 1 + done % stations, reg = done % 50;
        uint16_t v[4];
        modbus_set_slave(m, station);
        if (modbus_read_registers(m, reg, 4, v) != 4) failed++;
        else for (int i = 0; i < 4; i++) if (v[i] != (station << 8 | ((reg + i) & 255))) { wrong++; break; }
        done++;
    }
    printf("{\"done\": %ld, \"failed\": %ld, \"wrong\": %ld, \"cpu_s\": %f, \"wall_s\": %f}\n", done, failed, wrong, cpu() - c, wall() - w);
    return 0;
}
