/* A libmodbus RTU server: PATH ADDRESS. Tables of 128: holding registers 1000 + n, input registers 2000 + n, coils set
   where n % 3 == 0, discrete inputs where n % 2 == 1. Prints "ready" and serves for ever. */
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    modbus_t *m = modbus_new_rtu(argv[1], 115200, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(128, 128, 128, 128);
    if (!m || !map || modbus_set_slave(m, atoi(argv[2])) || modbus_connect(m)) return 1;
    modbus_set_response_timeout(m, 0, 1000); /* so long libmodbus' server waits before it sends an exception */
    for (int i = 0; i < 128; i++) {
        map->tab_registers[i] = (uint16_t)(1000 + i);
        map->tab_input_registers[i] = (uint16_t)(2000 + i);
        map->tab_bits[i] = i % 3 == 0;
        map->tab_input_bits[i] = i % 2 == 1;
    }
    puts("ready");
    fflush(stdout);
    for (;;) {
        uint8_t query[MODBUS_RTU_MAX_ADU_LENGTH];
        int n = modbus_receive(m, query);
        if (n > 0) modbus_reply(m, query, n, map);
    }
}
