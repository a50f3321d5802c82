#include "dfr/dds/channel.h"

// Sends a message to itself.
int main() {
  dfr::dds::Participant participant({.domain = 231});
  dfr::dds::Subscriber<dfr::dds::Text> subscriber(participant, "/note", dfr::dds::Role::kEvent);
  dfr::dds::Publisher<dfr::dds::Text> publisher(participant, "/note", dfr::dds::Role::kEvent);
  if (!publisher.Write({"hello"})) return 1;
  dfr::dds::Text text;
  for (int i = 0; i < 200 && !subscriber.Take(text); ++i) subscriber.Wait(0.1);
  return text.text == "hello" ? 0 : 1;
}
