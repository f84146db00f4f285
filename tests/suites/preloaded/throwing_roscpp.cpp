// Preloaded into a program on roscpp: the fifth message that it publishes, or the fifth time that one of its threads waits for
// callbacks, throws, as roscpp does where there is no memory. THROWS is "publish", or the thread that waits: "main", "other".
// What roscpp itself calls, on threads of its own, does not count.
#include <dlfcn.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>

static void throw_at_fifth(const char* what, const void* caller) {
  static std::atomic<int> calls{0};
  static const std::string wanted = std::getenv("THROWS");
  Dl_info library{};
  dladdr(caller, &library);
  if (!library.dli_fname || std::strstr(library.dli_fname, "/libroscpp.")) return;
  if (wanted == what && ++calls == 5) throw std::runtime_error("planted");
}

// Objects are passed by their address, or in one register.
using Call = void (*)(void*, void*, void*);

#define PUBLISH "_ZNK3ros9Publisher7publishERKN5boost8functionIFNS_17SerializedMessageEvEEERS3_"
void publish(void* self, void* serialize, void* message) __asm__(PUBLISH);
void publish(void* self, void* serialize, void* message) {
  throw_at_fifth("publish", __builtin_return_address(0));
  static const auto real = reinterpret_cast<Call>(dlsym(RTLD_NEXT, PUBLISH));
  real(self, serialize, message);
}

#define WAIT "_ZN3ros13CallbackQueue13callAvailableENS_12WallDurationE"
void wait_for_callbacks(void* self, void* limit, void* unused) __asm__(WAIT);
void wait_for_callbacks(void* self, void* limit, void* unused) {
  throw_at_fifth(syscall(SYS_gettid) == getpid() ? "main" : "other", __builtin_return_address(0));
  static const auto real = reinterpret_cast<Call>(dlsym(RTLD_NEXT, WAIT));
  real(self, limit, unused);
}
