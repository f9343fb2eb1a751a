/* Let User-Mode Linux write back the registers of its processes on a processor with Intel AMX.
 *
 * The kernel takes a set of extended registers (NT_X86_XSTATE, ptrace(2)) only whole. Debian's
 * User-Mode Linux reads and writes the first 2696 bytes, all there is without AMX. This library,
 * loaded before the C library, adds the rest: the tiles of AMX, in their initial state. A process
 * of a guest cannot change them, because the guest's kernel grants no use of them.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

typedef long function(int request, int process, void *address, void *data);

static char whole[1 << 16] __attribute__((aligned(64)));
static size_t size; /* of a whole set, known after the first write */

long ptrace(enum __ptrace_request request, ...)
{
    static function *next;
    va_list arguments;
    struct iovec *given, area = {whole, sizeof whole};

    va_start(arguments, request);
    int process = va_arg(arguments, int);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (!next)
        next = (function *)dlsym(RTLD_NEXT, "ptrace");
    if (request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return next(request, process, address, data);
    given = data;
    if (!size) {
        if (next(PTRACE_GETREGSET, process, address, &area))
            return -1;
        size = area.iov_len;
        memset(whole, 0, sizeof whole);
    }
    if (given->iov_len >= size)
        return next(request, process, address, data);
    memcpy(whole, given->iov_base, given->iov_len);
    area.iov_len = size;
    return next(request, process, address, &area);
}
