set(packages)
set(libraries rt)  # shm_open, before glibc 2.34
