// Preloaded into a program: locks of parts of files fail as under a kernel without CONFIG_FILE_LOCKING.
#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>

// Whatever the third argument is, it is in one register.
int answer(int file, int command, void* argument) __asm__("fcntl64");
int answer(int file, int command, void* argument) {
  if (command == F_OFD_SETLK || command == F_OFD_GETLK) {
    errno = command == F_OFD_SETLK ? EACCES : EINVAL;
    return -1;
  }
  return static_cast<int>(syscall(SYS_fcntl, file, command, argument));
}

int of_older_programs(int file, int command, void* argument) __asm__("fcntl");
int of_older_programs(int file, int command, void* argument) { return answer(file, command, argument); }
