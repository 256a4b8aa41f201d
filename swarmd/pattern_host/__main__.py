"""`python -m swarmd.pattern_host FD PARENT FOLDERS`: a pattern host, as `worker` describes it."""

from swarmd.core.openssl import without_openssl

with without_openssl():
    from swarmd.pattern_host.worker import main

if __name__ == "__main__":
    main()
