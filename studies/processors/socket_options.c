/* Passes on the socket options that qemu-user refuses, by LD_PRELOAD in the emulated program.

   qemu-user 7.2 and 10.0 answer ENOPROTOOPT for SO_TIMESTAMPNS, IP_MULTICAST_ALL and others, and 7.2
   ENODEV for IP_ADD_MEMBERSHIP by index; the kernel below has them. The socket and the option go to a process that is not emulated, at the Unix
   socket $SOCKET_OPTIONS (studies/processors/daemon.py), which sets the option of the same socket. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

int setsockopt(int sock, int level, int name, const void *value, socklen_t size)
{
    static int (*own)(int, int, int, const void *, socklen_t);
    const char *path = getenv("SOCKET_OPTIONS");
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    int words[2] = {level, name}, answer = ENOPROTOOPT, helper;
    struct iovec parts[2] = {{words, sizeof words}, {(void *)value, size}};
    char control[CMSG_SPACE(sizeof sock)] = {0};
    struct msghdr message = {.msg_iov = parts, .msg_iovlen = 2, .msg_control = control,
                             .msg_controllen = sizeof control};
    struct cmsghdr *head = CMSG_FIRSTHDR(&message);

    if (own == NULL)
        own = (int (*)(int, int, int, const void *, socklen_t))dlsym(RTLD_NEXT, "setsockopt");
    if (own(sock, level, name, value, size) == 0)
        return 0;
    if (path == NULL) /* else the kernel says what is wrong */
        return -1;
    head->cmsg_level = SOL_SOCKET;
    head->cmsg_type = SCM_RIGHTS;
    head->cmsg_len = CMSG_LEN(sizeof sock);
    memcpy(CMSG_DATA(head), &sock, sizeof sock);
    strncpy(to.sun_path, path, sizeof to.sun_path - 1);
    if ((helper = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) < 0)
        return -1;
    if (connect(helper, (struct sockaddr *)&to, sizeof to) != 0 || sendmsg(helper, &message, 0) < 0
        || read(helper, &answer, sizeof answer) != sizeof answer)
        answer = ENOPROTOOPT;
    close(helper);
    errno = answer;
    return answer ? -1 : 0;
}
