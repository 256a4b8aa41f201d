"""How datagrams and Zenoh messages travel: UDP, routers, sessions, links, floods."""
