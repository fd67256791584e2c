/* A plugin of qemu's user-mode emulation: counts the instructions of the emulated program, all its threads.

   The counts are in a file that other programs read while it runs: 64 numbers of 64 bits, 64 bytes apart, one per
   thread, to be added. Declared here is what it uses of qemu-plugin.h, which Debian has in no package. */

#include <fcntl.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

enum { THREADS = 64, APART = 8, SIZE = THREADS * APART * 8 };

struct qemu_plugin_tb;
typedef void (*on_block_translated)(uint64_t, struct qemu_plugin_tb *);
typedef void (*on_block_executed)(unsigned, void *);
void qemu_plugin_register_vcpu_tb_trans_cb(uint64_t, on_block_translated);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *, on_block_executed, int, void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);

/* Of the plugin interface; qemu refuses a plugin with a version that it does not have. */
int qemu_plugin_version = PLUGIN_VERSION;

static uint64_t *counts;

static void executed(unsigned thread, void *instructions)
{
    counts[thread % THREADS * APART] += (uintptr_t)instructions;
}

static void translated(uint64_t id, struct qemu_plugin_tb *block)
{
    void *instructions = (void *)(uintptr_t)qemu_plugin_tb_n_insns(block);
    qemu_plugin_register_vcpu_tb_exec_cb(block, executed, 0, instructions);
}

/* -plugin count.so,to=FILE */
int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv)
{
    int file = argc == 1 ? open(argv[0] + sizeof "to=" - 1, O_RDWR | O_CREAT, 0600) : -1;
    if (file < 0 || ftruncate(file, SIZE) != 0)
        return 1;
    counts = mmap(NULL, SIZE, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (counts == MAP_FAILED)
        return 1;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    return 0;
}
