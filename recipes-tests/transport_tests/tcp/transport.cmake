set(packages)
