//! The viewer tev (<https://github.com/Tom94/tev>), which is sent tiles over TCP. One that is not there, hangs or dies is a warning.

use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::Scope;
use std::time::Duration;

use bytemuck::cast_slice;
use octrace::Monitor;
use tev_client::{PacketCreateImage, PacketUpdateImage, TevClient};

use crate::live::{Done, Shown};

/// How long a viewer may take to answer, or to take what it is sent.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long it may take for what is left to be sent when the picture is done.
const AFTER: Duration = Duration::from_secs(10);
const CHANNELS: [&str; 3] = ["R", "G", "B"];

/// A viewer that is being sent to.
pub struct Display {
    ended: Receiver<()>,
    stream: Arc<Mutex<Option<TcpStream>>>,
}

/// Starts to send; tiles go to the sender.
pub fn start<'scope, 'a: 'scope>(
    scope: &'scope Scope<'scope, '_>,
    host: &'a str,
    shown: Shown<'a>,
    monitor: Monitor<'a>,
) -> (Sender<Done>, Display) {
    let (viewer, tiles) = channel();
    let (end, ended) = channel();
    let stream = Arc::new(Mutex::new(None));
    let own = stream.clone();
    scope.spawn(move || {
        if let Err(error) = send(host, shown, &tiles, &own) {
            monitor.warn(format!("the viewer at {host}: {error}; going on without it"));
        }
        // Nobody waits any more where the picture has come to its end first.
        end.send(()).unwrap_or_default();
    });
    (viewer, Display { ended, stream })
}

impl Display {
    /// Waits until what is left has been sent, but not for long.
    pub fn finish(self) {
        if self.ended.recv_timeout(AFTER).is_err() {
            let stream = self.stream.lock().unwrap_or_else(|poison| poison.into_inner());
            if let Some(stream) = stream.as_ref() {
                // One that is closed already needs no more.
                stream.shutdown(Shutdown::Both).unwrap_or_default();
            }
        }
    }
}

fn send(
    host: &str,
    shown: Shown<'_>,
    tiles: &Receiver<Done>,
    shared: &Mutex<Option<TcpStream>>,
) -> std::io::Result<()> {
    let stream = connect(host)?;
    stream.set_write_timeout(Some(PATIENCE))?;
    *shared.lock().unwrap_or_else(|poison| poison.into_inner()) = Some(stream.try_clone()?);
    let mut client = TevClient::wrap(stream);
    let image_name = &shown.place.to_string();
    let [width, height] = shown.size;
    client.send(PacketCreateImage { image_name, grab_focus: true, width, height, channel_names: &CHANNELS })?;
    for Done { place: [x, y, x1, y1], pixels } in tiles {
        client.send(PacketUpdateImage {
            image_name,
            grab_focus: false,
            channel_names: &CHANNELS,
            channel_offsets: &[0, 1, 2],
            channel_strides: &[3, 3, 3],
            x,
            y,
            width: x1 - x,
            height: y1 - y,
            data: cast_slice(&pixels),
        })?;
    }
    Ok(())
}

/// To the first address of that name that answers.
fn connect(host: &str) -> std::io::Result<TcpStream> {
    let mut failed = std::io::Error::new(std::io::ErrorKind::NotFound, "no such host");
    for address in host.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => return Ok(stream),
            Err(error) => failed = error,
        }
    }
    Err(failed)
}
