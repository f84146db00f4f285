/* Observe what is in effect while a run measures: runner/rtrun/on_target/sample.sh as one process that starts no other.
 *
 *   rt_tests_sampler FOLDER PRIORITY LOADS
 *
 * Arguments and output are those of sample.sh, whose first lines describe them; a test runs both side by side. It asks the
 * kernel by system calls where that is cheaper than the text of /proc, ends with 0 on SIGTERM or when FOLDER is removed,
 * and with 1, and a line on standard error, where it cannot go on. */
#define _GNU_SOURCE
#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <glob.h>
#include <inttypes.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum {
  LOST_MAX = 5, /* observations in a row that a full disk may cost: what happens in that time nobody sees */
  FIRST_PAUSE_S = 1,
  PAUSE_S = 2,
  FILES_AGE_MAX = 30,
  SESSIONS_MAX = 256,
  PROGRAM_MAX = 128,
  COUNT_NAME_MAX = 32,
  /* rtrun.validity.observations refuses more: COUNTS_MAX there includes the word "counts". */
  COUNTS_MAX = 511,
  STATE_LINES_MAX = 50000,
  /* Of a file of /proc as it is read, and of what is printed at once. */
  TEXT_BYTES_MAX = 16 << 20,
  /* Numbers of sched_setscheduler(2); the flag may be set with them. */
  POLICY_FIFO = 1,
  POLICY_RR = 2,
  POLICY_DEADLINE = 6,
  RESET_ON_FORK = 0x40000000,
};

/* A text that grows up to TEXT_BYTES_MAX, and keeps its memory when it is emptied. */
struct text {
  char *data;
  size_t length, capacity;
};

/* A program of the run, and its session. */
struct session {
  char program[PROGRAM_MAX];
  pid_t id;
  bool is_load, is_self;
};

/* The processes of a load, and where the first of them may run. */
struct load {
  unsigned processes;
  pid_t first;
};

/* Files that are looked for once a minute: those of a CPU or a sensor that was added. */
struct files {
  const char *pattern;
  glob_t paths;
  unsigned age;
};

struct thread {
  pid_t process, id;
};

struct count {
  char name[COUNT_NAME_MAX + 1];
  uint64_t total;
};

/* Those from `of_cpus` on are counted for the CPUs that are online, which the first line of /proc/interrupts names. */
struct counts {
  size_t number, of_cpus;
  struct text cpus;
  struct count count[COUNTS_MAX];
};

static struct session sessions[SESSIONS_MAX];
static struct load loads[SESSIONS_MAX];
static size_t session_number;
static long least_priority;
static const char *load_names;
static int proc;
/* Processes and threads that were ever begun, of the last look at /proc/stat; 0 where it does not tell. */
static uint64_t forks;
static struct files temperatures = {.pattern = "/sys/class/thermal/thermal_zone[0-9]*/temp"};
static struct files frequencies = {.pattern = "/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_cur_freq"};
static struct files governors = {.pattern = "/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"};
static struct files rt_runtime = {.pattern = "/proc/sys/kernel/sched_rt_runtime_us"};

static void fail(const char *what, const char *why) {
  fprintf(stderr, "rt_tests_sampler: %s: %s\n", what, why);
  exit(1);
}

/* Make room for this many bytes more and a NUL. */
static void reserve(struct text *text, size_t more) {
  const size_t needed = text->length + more + 1;
  if (needed <= text->capacity) {
    return;
  }
  if (needed > TEXT_BYTES_MAX) {
    fail("more than 16 MiB at once", "not what a target shows");
  }
  const size_t doubled = 2 * text->capacity < 4096 ? 4096 : 2 * text->capacity;
  const size_t capacity = doubled < needed ? needed : doubled;
  char *const data = realloc(text->data, capacity);
  if (data == NULL) {
    fail("memory", strerror(errno));
  }
  text->data = data;
  text->capacity = capacity;
}

static void append(struct text *text, const char *data, size_t length) {
  reserve(text, length);
  memcpy(text->data + text->length, data, length);
  text->length += length;
  text->data[text->length] = '\0';
}

__attribute__((format(printf, 2, 3))) static void add(struct text *text, const char *format, ...) {
  char line[1024];
  va_list values;
  va_start(values, format);
  const int length = vsnprintf(line, sizeof line, format, values);
  va_end(values);
  if (length > 0) {
    append(text, line, (size_t)length < sizeof line ? (size_t)length : sizeof line - 1);
  }
}

/* Append a whole file; false where it cannot be read, as that of a thread that has ended. */
static bool append_file(struct text *text, int folder, const char *path) {
  const int file = openat(folder, path, O_RDONLY | O_CLOEXEC);
  if (file < 0) {
    return false;
  }
  ssize_t got;
  do {
    reserve(text, 4096);
    got = read(file, text->data + text->length, text->capacity - text->length - 1);
    if (got > 0) {
      text->length += (size_t)got;
    }
  } while (got > 0 || (got < 0 && errno == EINTR));
  close(file);
  text->data[text->length] = '\0';
  return got == 0;
}

/* A whole file, in memory that the next call uses again; NULL where it cannot be read or is empty. */
static char *contents(int folder, const char *path) {
  static struct text text;
  text.length = 0;
  return append_file(&text, folder, path) && text.length > 0 ? text.data : NULL;
}

/* The first word of a file of /proc, or "-". */
static void add_first_word(struct text *out, const char *path) {
  const char *const text = contents(proc, path);
  const size_t length = text == NULL ? 0 : strcspn(text, " \n");
  append(out, length > 0 ? text : "-", length > 0 ? length : 1);
}

/* The lines of the files that a pattern names, separated by commas, or "-". */
static void add_joined(struct text *out, struct files *files) {
  const size_t begin = out->length;
  if (files->age++ % FILES_AGE_MAX == 0) {
    globfree(&files->paths);
    if (glob(files->pattern, 0, NULL, &files->paths) != 0) {
      memset(&files->paths, 0, sizeof files->paths);
    }
  }
  for (size_t number = 0; number < files->paths.gl_pathc; ++number) {
    const char *const text = contents(AT_FDCWD, files->paths.gl_pathv[number]);
    if (text != NULL) {
      append(out, text, strlen(text));
    }
  }
  for (size_t at = begin; at < out->length; ++at) {
    out->data[at] = out->data[at] == '\n' ? ',' : out->data[at];
  }
  if (out->length > begin && out->data[out->length - 1] == ',') {
    out->data[--out->length] = '\0';
  }
  if (out->length == begin) {
    append(out, "-", 1);
  }
}

/* Counts. */

/* Where a name has been counted. The lines of /proc keep their order: look first where it was. */
static uint64_t counted_before(const struct counts *before, const char *name, size_t place) {
  for (size_t step = 0; step < before->number; ++step) {
    const struct count *const entry = &before->count[(place + step) % before->number];
    if (strcmp(entry->name, name) == 0) {
      return entry->total;
    }
  }
  return 0;
}

static void count(struct counts *now, const char *name, size_t length, uint64_t total) {
  if (total == 0 || length == 0 || now->number == COUNTS_MAX) {
    return;
  }
  struct count *const added = &now->count[now->number++];
  const size_t kept = length < COUNT_NAME_MAX ? length : COUNT_NAME_MAX;
  for (size_t at = 0; at < kept; ++at) {
    const bool is_plain = (isascii(name[at]) && isalnum((unsigned char)name[at])) || strchr("_.:-", name[at]) != NULL;
    added->name[at] = is_plain ? name[at] : '_';
  }
  added->name[kept] = '\0';
  added->total = total;
}

/* The line after this one; NULL at the end. The line itself is cut off. */
static char *cut_line(char *line) {
  char *const end = strchr(line, '\n');
  if (end == NULL) {
    return NULL;
  }
  *end = '\0';
  return end + 1;
}

static void count_stat(struct counts *now, char *line) {
  enum { FORKS = 2 };
  forks = 0;
  static const struct {
    const char *begin, *name;
  } known[] = {{"intr ", "interrupts"}, {"ctxt ", "context_switches"}, {"processes ", "new_processes"}};
  for (char *next; line != NULL; line = next) {
    next = cut_line(line);
    for (size_t place = 0; place < sizeof known / sizeof *known; ++place) {
      const size_t length = strlen(known[place].begin);
      if (strncmp(line, known[place].begin, length) == 0) {
        const uint64_t total = strtoull(line + length, NULL, 10);
        count(now, known[place].name, strlen(known[place].name), total);
        forks = place == FORKS ? total : forks;
      }
    }
  }
}

static void count_memory_stall(struct counts *now) {
  const char *const text = contents(proc, "pressure/memory");
  const char *const total = text != NULL && strncmp(text, "some ", 5) == 0 ? strstr(text, "total=") : NULL;
  if (total != NULL) {
    count(now, "memory_stall_us", strlen("memory_stall_us"), strtoull(total + strlen("total="), NULL, 10));
  }
}

/* Each line is "24:", a number for each CPU, and words of which the last one names the device. */
static void count_interrupts(struct counts *now) {
  now->of_cpus = now->number;
  now->cpus.length = 0;
  append(&now->cpus, "", 0);
  char *line = contents(proc, "interrupts");
  size_t cpus = 0;
  for (char *next; line != NULL; line = next) {
    next = cut_line(line);
    if (cpus == 0 && strncmp(line + strspn(line, " \t"), "CPU", 3) == 0) {
      append(&now->cpus, line, strlen(line));
    }
    char *rest = NULL, *const first = strtok_r(line, " \t", &rest);
    if (first == NULL) {
      continue;
    }
    char *word = strtok_r(NULL, " \t", &rest), *last = first;
    if (strncmp(first, "CPU", 3) == 0) {
      for (cpus = 1; word != NULL; word = strtok_r(NULL, " \t", &rest)) {
        ++cpus;
      }
    }
    size_t length = strlen(first);
    if (cpus == 0 || first[length - 1] != ':') {
      continue;
    }
    uint64_t total = 0;
    for (size_t cpu = 0; word != NULL && cpu < cpus && word[strspn(word, "0123456789")] == '\0'; ++cpu) {
      total += strtoull(word, NULL, 10);
      last = word;
      word = strtok_r(NULL, " \t", &rest);
    }
    for (; word != NULL; word = strtok_r(NULL, " \t", &rest)) {
      last = word;
    }
    char name[2 * COUNT_NAME_MAX];
    if (isdigit((unsigned char)first[0])) {
      const int needed = snprintf(name, sizeof name, "%s%s", first, last);
      length = (size_t)needed < sizeof name ? (size_t)needed : sizeof name - 1;
      length -= name[length - 1] == ':';
      count(now, name, length, total);
    } else {
      count(now, first, length - 1, total);
    }
  }
}

/* Threads. */

static bool is_load(const char *program) {
  const size_t length = strlen(program);
  for (const char *at = load_names; *at != '\0'; at += strcspn(at, " ")) {
    at += strspn(at, " ");
    if (strcspn(at, " ") == length && strncmp(at, program, length) == 0) {
      return true;
    }
  }
  return false;
}

static const struct session *session_of(pid_t id) {
  for (size_t number = 0; number < session_number; ++number) {
    if (sessions[number].id == id) {
      return &sessions[number];
    }
  }
  return NULL;
}

/* Read each NAME.pid of the folder that has not been read yet; it is written once. */
static void find_sessions(DIR *folder) {
  rewinddir(folder);
  for (const struct dirent *entry; (entry = readdir(folder)) != NULL;) {
    const char *const ending = strrchr(entry->d_name, '.');
    if (ending == NULL || strcmp(ending, ".pid") != 0) {
      continue;
    }
    const size_t length = (size_t)(ending - entry->d_name);
    size_t number = 0;
    while (number < session_number && (strncmp(sessions[number].program, entry->d_name, length) != 0 ||
                                       sessions[number].program[length] != '\0')) {
      ++number;
    }
    const char *const text = number < session_number ? NULL : contents(dirfd(folder), entry->d_name);
    if (text == NULL || strchr(text, '\n') == NULL) {
      continue;
    }
    if (length >= PROGRAM_MAX || session_number == SESSIONS_MAX) {
      fail(entry->d_name, "more programs, or a longer name, than a run has");
    }
    struct session *const added = &sessions[session_number++];
    memcpy(added->program, entry->d_name, length);
    added->program[length] = '\0';
    added->id = (pid_t)strtol(text, NULL, 10);
    added->is_load = is_load(added->program);
    added->is_self = strcmp(added->program, "sampler") == 0;
  }
}

/* The name of a thread, in which "\n" stands for a line end: /proc has it as it is. False when it has ended, or waits
 * as a zombie for its parent: it keeps its policy and never runs again. */
static bool read_name(pid_t process, pid_t thread, char *name, size_t size) {
  char path[64];
  snprintf(path, sizeof path, "%d/task/%d/stat", (int)process, (int)thread);
  const char *const text = contents(proc, path);
  /* The name itself may hold brackets; behind it there are only numbers and a letter. */
  const char *const begin = text == NULL ? NULL : strchr(text, '('), *const end = text == NULL ? NULL : strrchr(text, ')');
  if (begin == NULL || end == NULL || end < begin) {
    return false;
  }
  if (strncmp(end, ") Z", 3) == 0 || strncmp(end, ") X", 3) == 0 || strncmp(end, ") x", 3) == 0) {
    return false;
  }
  size_t length = 0;
  for (const char *at = begin + 1; at < end && length + 2 < size; ++at) {
    if (*at == '\n') {
      name[length++] = '\\';
    }
    name[length++] = *at == '\n' ? 'n' : *at;
  }
  name[length] = '\0';
  return true;
}

static void add_cpus(struct text *out, pid_t process, pid_t thread) {
  static const char key[] = "\nCpus_allowed_list:\t";
  char path[64];
  snprintf(path, sizeof path, "%d/task/%d/status", (int)process, (int)thread);
  const char *const text = contents(proc, path), *const found = text == NULL ? NULL : strstr(text, key);
  const char *const list = found == NULL ? "-" : found + sizeof key - 1;
  append(out, list, strcspn(list, "\n"));
}

/* RUNTIME_NS/PERIOD_NS of a thread at SCHED_DEADLINE, "-" where the kernel does not tell. */
static void add_budget(struct text *out, pid_t thread) {
  /* struct sched_attr of sched_getattr(2) in its first version; not every C library has it, or the call. */
  struct {
    uint32_t size, policy;
    uint64_t flags;
    int32_t nice;
    uint32_t priority;
    uint64_t runtime_ns, deadline_ns, period_ns;
  } attributes = {0};
#ifdef SYS_sched_getattr
  if (syscall(SYS_sched_getattr, thread, &attributes, sizeof attributes, 0U) == 0 &&
      attributes.policy == POLICY_DEADLINE) {
    add(out, "%" PRIu64 "/%" PRIu64, attributes.runtime_ns, attributes.period_ns);
    return;
  }
#endif
  append(out, "-", 1);
}

static void add_thread(struct text *out, const struct session *session, pid_t process, pid_t thread) {
  /* The C libraries' functions are about processes, or do nothing. */
  const long scheduler = syscall(SYS_sched_getscheduler, thread);
  if (scheduler < 0) {
    return;
  }
  const int policy = (int)(scheduler & ~(long)RESET_ON_FORK);
  int priority = 0;
  if (policy == POLICY_FIFO || policy == POLICY_RR) {
    if (syscall(SYS_sched_getparam, thread, &priority) != 0) {
      return;
    }
  }
  const bool is_rival = policy == POLICY_DEADLINE || (priority > 0 && priority >= least_priority);
  char name[256];
  if ((session == NULL && !is_rival) || !read_name(process, thread, name, sizeof name)) {
    return;
  }
  if (session == NULL) {
    add(out, "rival %d %d ", (int)thread, policy);
    if (policy == POLICY_DEADLINE) {
      add_budget(out, thread);
    } else {
      add(out, "%d", priority);
    }
    add(out, " %s\n", name);
    /* supervise.sh and its watchdog, which sleeps and waits for a lock, are not the program that they started. */
  } else if (strcmp(name, "supervise.sh") == 0 || strcmp(name, "sleep") == 0 || strcmp(name, "flock") == 0) {
    return;
  } else if (session->is_load) {
    struct load *const load = &loads[session - sessions];
    load->first = load->processes++ == 0 ? process : load->first;
  } else {
    add(out, "thread %s %d %d %d ", session->program, (int)thread, policy, priority);
    add_cpus(out, process, thread);
    add(out, " %s\n", name);
  }
}

/* The number that a name consists of; 0 for any other name. */
static pid_t number_of(const char *name) {
  return name[strspn(name, "0123456789")] == '\0' ? (pid_t)strtol(name, NULL, 10) : 0;
}

static void list_process(struct text *threads, pid_t process) {
  char path[64];
  struct stat task;
  struct thread found = {process, process};
  snprintf(path, sizeof path, "%d/task", (int)process);
  /* The folder has a link from each thread in addition to the two of every folder: only where there are several it is read. */
  if (fstatat(proc, path, &task, 0) == 0 && task.st_nlink == 3) {
    append(threads, (const char *)&found, sizeof found);
    return;
  }
  const int folder = openat(proc, path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  DIR *const tasks = folder < 0 ? NULL : fdopendir(folder);
  if (tasks == NULL) {
    return;
  }
  for (const struct dirent *entry; (entry = readdir(tasks)) != NULL;) {
    found.id = number_of(entry->d_name);
    if (found.id > 0) {
      append(threads, (const char *)&found, sizeof found);
    }
  }
  closedir(tasks);
}

/* All threads, and the programs of the run; to ask for them again costs more than all else, and is needed only after something
 * was begun. A program is begun after its NAME.pid was written. */
static const struct text *list_threads(DIR *folder, DIR *processes) {
  static struct text threads;
  static uint64_t listed;
  if (forks == 0 || forks != listed) {
    find_sessions(folder);
    threads.length = 0;
    rewinddir(processes);
    for (const struct dirent *entry; (entry = readdir(processes)) != NULL;) {
      const pid_t process = number_of(entry->d_name);
      if (process > 0) {
        list_process(&threads, process);
      }
    }
    listed = forks;
  }
  return &threads;
}

static void add_threads(struct text *out, const struct text *threads) {
  const struct session *session = NULL;
  pid_t process = 0, id = -1;
  memset(loads, 0, sizeof loads);
  for (size_t at = 0; at < threads->length; at += sizeof(struct thread)) {
    struct thread thread;
    memcpy(&thread, threads->data + at, sizeof thread);
    if (thread.process != process) {
      process = thread.process;
      id = getsid(process);
      session = id > 0 ? session_of(id) : NULL;
    }
    const bool is_left_out = session != NULL && (session->is_self || (session->is_load && thread.id != process));
    if (id >= 0 && !is_left_out) {
      add_thread(out, session, process, thread.id);
    }
  }
}

static void add_state(struct text *out, const struct text *threads) {
  add_threads(out, threads);
  /* The CPUs of one process of each load are enough: its other processes inherit them. */
  for (size_t number = 0; number < session_number; ++number) {
    if (loads[number].processes > 0) {
      add(out, "load %s %u ", sessions[number].program, loads[number].processes);
      add_cpus(out, loads[number].first, loads[number].first);
      append(out, "\n", 1);
    }
  }
  append(out, "governor ", strlen("governor "));
  add_joined(out, &governors);
  append(out, "\nsched_rt_runtime_us ", strlen("\nsched_rt_runtime_us "));
  add_joined(out, &rt_runtime);
  append(out, "\n", 1);
  size_t lines = 0;
  for (const char *at = out->data; (at = strchr(at, '\n')) != NULL; ++at) {
    ++lines;
  }
  if (lines > STATE_LINES_MAX) {
    fail("more than 50000 lines of state", "not what a target shows");
  }
}

/* Print all of a text or, where the disk is full, nothing of it: an observation that is missing is none that is damaged. */
static bool print(const struct text *text) {
  const off_t begin = lseek(STDOUT_FILENO, 0, SEEK_CUR);
  for (size_t done = 0; done < text->length;) {
    const ssize_t wrote = write(STDOUT_FILENO, text->data + done, text->length - done);
    if (wrote < 0 && errno == EINTR) {
      continue;
    }
    if (wrote <= 0) {
      if (begin < 0 || ftruncate(STDOUT_FILENO, begin) != 0 || lseek(STDOUT_FILENO, begin, SEEK_SET) < 0) {
        fail("standard output", strerror(errno));
      }
      return false;
    }
    done += (size_t)wrote;
  }
  return true;
}

/* The first line of /proc/stat goes into `busy`. */
static void take_counts(struct counts *now, struct text *busy) {
  char *const stat = contents(proc, "stat");
  if (stat == NULL) {
    fail("/proc/stat", strerror(errno));
  }
  busy->length = 0;
  append(busy, stat, strcspn(stat, "\n"));
  now->number = 0;
  count_stat(now, stat);
  count_memory_stall(now);
  count_interrupts(now);
}

static void add_counts(struct text *out, const struct counts *now, const struct counts *before) {
  append(out, "\ncounts", strlen("\ncounts"));
  /* What a CPU had counted before it went offline is counted again once it is back, and is not new. */
  const bool are_same_cpus = before->cpus.data != NULL && strcmp(now->cpus.data, before->cpus.data) == 0;
  const size_t end = are_same_cpus ? now->number : now->of_cpus;
  for (size_t place = 0; before->number > 0 && place < end; ++place) {
    const struct count *const entry = &now->count[place];
    const uint64_t old = counted_before(before, entry->name, place);
    if (entry->total > old) {
      add(out, " %s=%" PRIu64, entry->name, entry->total - old);
    }
  }
  append(out, "\n", 1);
}

static void observe(DIR *folder, DIR *processes) {
  static struct counts counts[2];
  static struct text states[2], busy, out;
  /* Which of the two is of the observation that was printed last. */
  static unsigned last_counts, last_state;
  /* Observations that found no room, one after the other. */
  static unsigned lost;
  struct counts *const now = &counts[!last_counts];
  struct text *const state = &states[!last_state], *const before = &states[last_state];

  out.length = 0;
  append(&out, "at ", 3);
  add_first_word(&out, "uptime");
  append(&out, " ", 1);
  add_first_word(&out, "loadavg");
  append(&out, " ", 1);
  take_counts(now, &busy);
  add_joined(&out, &temperatures);
  append(&out, " ", 1);
  add_joined(&out, &frequencies);
  append(&out, " ", 1);
  append(&out, busy.data, busy.length);
  add_counts(&out, now, &counts[last_counts]);

  state->length = 0;
  add_state(state, list_threads(folder, processes));
  const bool has_changed =
      state->length != before->length || memcmp(state->data, before->data, state->length) != 0;
  if (has_changed) {
    append(&out, state->data, state->length);
    append(&out, "end ", 4);
    add_first_word(&out, "uptime");
    append(&out, "\n", 1);
  }
  if (print(&out)) {
    last_counts = !last_counts;
    last_state = has_changed ? !last_state : last_state;
    lost = 0;
  } else if (++lost == LOST_MAX) {
    /* The runner knows it by that: on a full disk no word has room. */
    exit(ENOSPC);
  }
}

int main(int argc, char **argv) {
  if (argc != 4) {
    fprintf(stderr, "usage: rt_tests_sampler FOLDER PRIORITY LOADS\n");
    return 2;
  }
  least_priority = strtol(argv[2], NULL, 10);
  load_names = argv[3];
  DIR *const folder = opendir(argv[1]);
  DIR *const processes = opendir("/proc");
  if (folder == NULL || processes == NULL) {
    fail(folder == NULL ? argv[1] : "/proc", strerror(errno));
  }
  proc = dirfd(processes);
  setpriority(PRIO_PROCESS, 0, 19);
  /* SIGTERM is waited for between two observations, so that lines are whole. One that is ignored would never come. */
  signal(SIGTERM, SIG_DFL);
  sigset_t end;
  sigemptyset(&end);
  sigaddset(&end, SIGTERM);
  sigprocmask(SIG_BLOCK, &end, NULL);
  struct timespec pause = {.tv_sec = FIRST_PAUSE_S};
  for (;;) {
    struct stat status;
    const int received = sigtimedwait(&end, NULL, &pause);
    if (received < 0 && errno == EINTR) {
      continue; /* stopped and continued */
    }
    if (received == SIGTERM || fstat(dirfd(folder), &status) != 0 || status.st_nlink == 0) {
      return 0;
    }
    observe(folder, processes);
    pause.tv_sec = PAUSE_S;
  }
}
