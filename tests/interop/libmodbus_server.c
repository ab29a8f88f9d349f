/* A libmodbus RTU server: PATH ADDRESS. Holding registers 0-127 begin as 1000 + n; prints "ready" and serves for ever. */
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    modbus_t *m = modbus_new_rtu(argv[1], 19200, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, 128, 0);
    if (!m || !map || modbus_set_slave(m, atoi(argv[2])) || modbus_connect(m)) return 1;
    for (int i = 0; i < 128; i++) map->tab_registers[i] = (uint16_t)(1000 + i);
    puts("ready");
    fflush(stdout);
    for (;;) {
        uint8_t query[MODBUS_RTU_MAX_ADU_LENGTH];
        int n = modbus_receive(m, query);
        if (n > 0) modbus_reply(m, query, n, map);
    }
}
