#pragma once

#include <sys/socket.h>
#include <sys/types.h>

#include <cerrno>
#include <cstddef>

namespace dfr::imitation::internal {

/// Sends all bytes. @returns false if the peer has closed the connection.
inline bool SendAll(int socket, const void* bytes, std::size_t size) noexcept {
  const char* from = static_cast<const char*>(bytes);
  while (size > 0) {
    const ssize_t sent = send(socket, from, size, MSG_NOSIGNAL);
    if (sent < 0 && errno == EINTR) continue;
    if (sent <= 0) return false;
    from += sent;
    size -= static_cast<std::size_t>(sent);
  }
  return true;
}

/// Receives exactly this many bytes. @returns false if the peer closes the connection before the
/// last byte.
inline bool ReceiveAll(int socket, void* bytes, std::size_t size) noexcept {
  char* to = static_cast<char*>(bytes);
  while (size > 0) {
    const ssize_t received = recv(socket, to, size, 0);
    if (received < 0 && errno == EINTR) continue;
    if (received <= 0) return false;
    to += received;
    size -= static_cast<std::size_t>(received);
  }
  return true;
}

}  // namespace dfr::imitation::internal
